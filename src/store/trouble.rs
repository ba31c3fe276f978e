//! Problems of the store, as the text of an alarm.

use super::{
    database::Store,
    dropped::Dropped,
    files::{
        DatabaseFiles,
        disk::{DiskLevel, Replaced},
    },
};
use crate::{diagnose::Severity, throw::counted};

impl Store {
    /// The highest severity of all problems that exist now or occurred since the last call, and of the problems in
    /// `more`, with one text for all of them. `None` without problems. Called every few seconds, so it must be fast.
    ///
    /// The alarm can be stored even on a full disk: its first write fails and removes the ballast, whose space is
    /// enough for thousands of alarms.
    pub fn trouble(&self, more: impl IntoIterator<Item = (Severity, String)>) -> Option<(Severity, String)> {
        let disk = match self.disk.worst_level() {
            DiskLevel::Ample => None,
            DiskLevel::Low => Some((
                Severity::Warning,
                "its disk is nearly full, and traces of judged throws are dropped. Free some space",
            )),
            DiskLevel::Full => Some((Severity::Critical, "its disk is full, and writes fail. Free some space now")),
            DiskLevel::Failing => Some((
                Severity::Critical,
                "writing to its database fails, and received throws wait. Check whether another program holds a lock of the \
                 file, then the disk",
            )),
        };
        let disk = disk.map(|(severity, text)| (severity, text.to_owned()));
        let set_aside = self.files.set_aside_before().map(|file| {
            let saved = DatabaseFiles::saved_from(&file);
            let saved = saved.unwrap_or_else(|| "its history is not available".to_owned());
            let was = if file.as_os_str().as_encoded_bytes().ends_with(b"-log") {
                "was missing; its write-ahead log"
            } else {
                "was broken and"
            };
            let text = format!(
                "its database {was} was set aside as {}; {saved}. Move this file elsewhere, and keep it for a \
                 later recovery",
                file.display()
            );
            (Severity::Critical, text)
        });
        let replaced = self.disk.replaced().map(|replaced| {
            let file = self.path().display();
            let text = match replaced {
                Replaced::WrittenAgain(None) => format!(
                    "its database {file} or the write-ahead log of it was deleted during operation. All data were \
                     written to a new file there. Find out who or what deleted it"
                ),
                Replaced::WrittenAgain(Some(foreign)) => format!(
                    "its database {file} was replaced during operation. All data were written to a new file there, and the file \
                     found in its place is now {}. If this was a backup to restore, stop pointsd first, then put it in place. \
                     Otherwise find out who or what replaced the database",
                    foreign.display()
                ),
                Replaced::Failed => format!(
                    "its database {file} was deleted or replaced during operation, and cannot be written again. Check its folder \
                     and disk, and do not stop pointsd before: it has the only copy open"
                ),
            };
            (Severity::Critical, text)
        });
        let losses = [
            (
                Dropped::PendingThrows,
                "throw",
                "before judging: pending throws fill store.max_size_mib, or are more than store.max_traces or \
                 store.max_throws, mostly of one machine. Check the logger that sends so many",
            ),
            (Dropped::Messages, "alarm event", "before publishing, as too many were waiting. Check the link of zenoh"),
            (
                Dropped::Notifications,
                "alarm event",
                "before the webhook accepted them, as too many were waiting. Check its receiver (webhook.url)",
            ),
        ];
        let dropped = losses.into_iter().filter_map(|(what, noun, rest)| {
            let count = counted(self.drop_counts.recent(what)?, noun);
            Some((Severity::Critical, format!("it dropped {count} {rest}")))
        });
        let all: Vec<(Severity, String)> =
            disk.into_iter().chain(set_aside).chain(replaced).chain(dropped).chain(more).collect();
        let severity = all.iter().map(|(severity, _)| *severity).max()?;
        let texts: Vec<&str> = all.iter().map(|(_, text)| text.as_str()).collect();
        Some((severity, format!("pointsd loses data: {}.", texts.join("; "))))
    }
}
