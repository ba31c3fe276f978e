//! Problems of the store, as texts for an alarm.

use super::{database::Store, disk::DiskLevel, files::DatabaseFiles};
use crate::diagnose::Severity;

impl Store {
    /// The highest severity and one text for all present problems, for those since the last call, and for `more`.
    /// Cheap: called every few seconds. The alarm can be stored on a full disk too: its write fails once, which removes
    /// the ballast, and the freed space holds thousands of alarms.
    pub fn trouble(&self, more: Option<(Severity, String)>) -> Option<(Severity, String)> {
        let disk = match self.disk.worst_level() {
            DiskLevel::Ample => None,
            DiskLevel::Low => Some((
                Severity::Warning,
                "its disk is nearly full, and traces of judged throws are dropped. Free some space",
            )),
            DiskLevel::Full => Some((Severity::Critical, "its disk is full, and writes fail. Free some space now")),
            DiskLevel::Failing => Some((
                Severity::Critical,
                "writing to its disk fails, and received throws cannot be stored. Check the disk",
            )),
        };
        let disk = disk.map(|(severity, said)| (severity, said.to_owned()));
        let set_aside = self.files.set_aside_before().map(|file| {
            let saved = DatabaseFiles::saved_from(&file);
            let saved = saved.unwrap_or_else(|| "its history is not available".to_owned());
            let said = format!(
                "its database was broken and was set aside as {}; {saved}. Move this file elsewhere, and keep it for a \
                 later recovery",
                file.display()
            );
            (Severity::Critical, said)
        });
        let replaced = self.disk.replaced().map(|succeeded| {
            let file = self.path().display();
            let said = if succeeded {
                format!(
                    "the file of its database was deleted or replaced during operation; all data were written again to {file}. \
                     A foreign file there is now {file}-replaced-…. Find out the reason"
                )
            } else {
                format!("the file {file} of its database was deleted or replaced during operation, and cannot be written again")
            };
            (Severity::Critical, said)
        });
        let [throws, messages, notifications] = self.disk.lost();
        let throws = throws.map(|throws| {
            format!(
                "{throws} throws were dropped before they were judged: pending throws fill store.max_size_mib or are more than store.max_traces, mostly \
                 of one machine. Check the logger that sends so many"
            )
        });
        let messages = messages.map(|events| {
            format!(
                "{events} alarm events were dropped before they were published, as too many were waiting. Check the link \
                 of zenoh"
            )
        });
        let notifications = notifications.map(|events| {
            format!(
                "{events} alarm events were dropped before the webhook accepted them, as too many were waiting. Check \
                 its receiver (webhook.url)"
            )
        });
        let dropped = [throws, messages, notifications].into_iter().flatten().map(|said| (Severity::Critical, said));
        let all: Vec<(Severity, String)> =
            disk.into_iter().chain(set_aside).chain(replaced).chain(dropped).chain(more).collect();
        let severity = all.iter().map(|(severity, _)| *severity).max()?;
        let said: Vec<&str> = all.iter().map(|(_, said)| said.as_str()).collect();
        Some((severity, format!("pointsd loses data: {}.", said.join("; "))))
    }
}
