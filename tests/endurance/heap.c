/* Preloaded into the daemon: what glibc's allocator has handed out and not got back, and what it keeps free for the next
 * request, once a second into the file HEAP_FILE [bytes]. The memory of a process is both, and more. */
#include <fcntl.h>
#include <malloc.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <unistd.h>

static void *tell(void *file)
{
    int fd = open(file, O_WRONLY | O_CREAT | O_CLOEXEC, 0600);
    for (;;) {
        struct mallinfo2 heap = mallinfo2();
        char line[64];
        /* Always as long: a reader never sees the rest of a longer one. */
        int size = snprintf(line, sizeof line, "%20zu %20zu\n", heap.uordblks + heap.hblkhd, heap.fordblks);
        if (pwrite(fd, line, size, 0) != size)
            abort();
        sleep(1);
    }
    return NULL;
}

__attribute__((constructor)) static void start(void)
{
    pthread_t thread;
    char *file = getenv("HEAP_FILE");
    if (file && pthread_create(&thread, NULL, tell, file) == 0)
        pthread_detach(thread);
}
