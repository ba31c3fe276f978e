/* Preloaded into a process that writes a database. Two uses, chosen by environment variables:
 *
 * SHIM_LOG=FILE    every write, sync, truncation and name change of the files whose path contains SHIM_MATCH is
 *                  appended to FILE in the order in which it happened, so that a power cut can be replayed anywhere.
 *                  What is written to a file that ends in ".ack" is logged as an acknowledgement.
 * SHIM_FAIL=what:nth:errno:times   the nth write or sync ("write", "sync") of those files fails, and when times is
 *                  "forever" all later ones too.
 *
 * One record: kind (1 byte), path length (u32), data length (u32), offset (u64), path, data. Native byte order.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <pthread.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/uio.h>
#include <unistd.h>

static pthread_mutex_t lock = PTHREAD_RECURSIVE_MUTEX_INITIALIZER_NP;
static int log_fd = -1;
static const char *match;
static char fail_what[16];
static long fail_nth, seen, fail_errno;
static int fail_forever;

#define REAL(name) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))

__attribute__((constructor)) static void start(void) {
    match = getenv("SHIM_MATCH");
    const char *log = getenv("SHIM_LOG");
    if (log) log_fd = REAL(open)(log, O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0644);
    const char *fail = getenv("SHIM_FAIL");
    char times[16] = "";
    if (fail && sscanf(fail, "%15[^:]:%ld:%ld:%15s", fail_what, &fail_nth, &fail_errno, times) == 4)
        fail_forever = strcmp(times, "forever") == 0;
}

static int ours(const char *path) {
    if (!match || !strstr(path, match)) return 0;
    size_t n = strlen(path);
    return !(n > 4 && strcmp(path + n - 4, "-shm") == 0) && !strstr(path, "-ballast") && !strstr(path, "(deleted)");
}

static int path_of(int fd, char *path) {
    char link[64];
    snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    ssize_t n = readlink(link, path, PATH_MAX - 1);
    if (n < 0) return 0;
    path[n] = 0;
    return ours(path);
}

/* One call, so that a record is whole beside those that another process appends. */
static void record(char kind, const char *path, uint64_t offset, const void *data, uint32_t size) {
    if (log_fd < 0) return;
    uint32_t path_size = (uint32_t)strlen(path);
    char head[17];
    head[0] = kind;
    memcpy(head + 1, &path_size, 4);
    memcpy(head + 5, &size, 4);
    memcpy(head + 9, &offset, 8);
    struct iovec parts[3] = {{head, sizeof head}, {(void *)path, path_size}, {(void *)data, size}};
    if (writev(log_fd, parts, 3) != (ssize_t)(sizeof head + path_size + size)) abort();
}

static int fails(const char *what) {
    if (strcmp(fail_what, what) != 0) return 0;
    seen++;
    if (seen != fail_nth && !(fail_forever && seen > fail_nth)) return 0;
    errno = (int)fail_errno;
    return 1;
}

static int is_ack(const char *path) {
    size_t n = strlen(path);
    return n > 4 && strcmp(path + n - 4, ".ack") == 0;
}

static ssize_t written(int fd, const void *data, size_t size, off_t offset, int seek) {
    char path[PATH_MAX];
    pthread_mutex_lock(&lock);
    ssize_t n = -1;
    int known = path_of(fd, path), ack = known && is_ack(path);
    if (!(known && !ack && fails("write"))) {
        uint64_t at = seek ? (uint64_t)lseek(fd, 0, SEEK_CUR) : (uint64_t)offset;
        n = seek ? REAL(write)(fd, data, size) : REAL(pwrite64)(fd, data, size, offset);
        if (known && n > 0) record(ack ? 'A' : 'W', path, at, data, (uint32_t)n);
    }
    int saved = errno;
    pthread_mutex_unlock(&lock);
    errno = saved;
    return n;
}

ssize_t write(int fd, const void *data, size_t size) { return written(fd, data, size, 0, 1); }
ssize_t pwrite(int fd, const void *data, size_t size, off_t offset) { return written(fd, data, size, offset, 0); }
ssize_t pwrite64(int fd, const void *data, size_t size, off64_t offset) { return written(fd, data, size, offset, 0); }

static int synced(int fd, int (*sync)(int)) {
    char path[PATH_MAX];
    struct stat st;
    pthread_mutex_lock(&lock);
    int known = path_of(fd, path), r = -1;
    int folder = fstat(fd, &st) == 0 && S_ISDIR(st.st_mode);
    if (!(known && fails("sync"))) {
        r = sync(fd);
        if (r == 0 && folder) record('D', "", 0, "", 0);
        else if (r == 0 && known) record('S', path, 0, "", 0);
    }
    int saved = errno;
    pthread_mutex_unlock(&lock);
    errno = saved;
    return r;
}

int fsync(int fd) { return synced(fd, REAL(fsync)); }
int fdatasync(int fd) { return synced(fd, REAL(fdatasync)); }

static int truncated(int fd, off_t size) {
    char path[PATH_MAX];
    pthread_mutex_lock(&lock);
    int known = path_of(fd, path), r = -1;
    if (!(known && fails("write"))) {
        r = REAL(ftruncate64)(fd, size);
        if (known && r == 0) record('T', path, (uint64_t)size, "", 0);
    }
    int saved = errno;
    pthread_mutex_unlock(&lock);
    errno = saved;
    return r;
}

int ftruncate(int fd, off_t size) { return truncated(fd, size); }
int ftruncate64(int fd, off64_t size) { return truncated(fd, size); }

int unlink(const char *path) {
    pthread_mutex_lock(&lock);
    int r = REAL(unlink)(path), saved = errno;
    if (r == 0 && ours(path)) record('U', path, 0, "", 0);
    pthread_mutex_unlock(&lock);
    errno = saved;
    return r;
}

int rename(const char *from, const char *to) {
    pthread_mutex_lock(&lock);
    int r = REAL(rename)(from, to), saved = errno;
    if (r == 0 && ours(from)) record('R', from, 0, to, (uint32_t)strlen(to));
    pthread_mutex_unlock(&lock);
    errno = saved;
    return r;
}

int symlink(const char *target, const char *path) {
    pthread_mutex_lock(&lock);
    int r = REAL(symlink)(target, path), saved = errno;
    if (r == 0 && ours(path)) record('L', path, 0, target, (uint32_t)strlen(target));
    pthread_mutex_unlock(&lock);
    errno = saved;
    return r;
}
