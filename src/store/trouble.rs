//! Why the store loses data, in words for an alarm.

use super::{database::Store, disk::DiskLevel, place::Place};
use crate::diagnose::Severity;

impl Store {
    /// Severity and text of everything that is wrong now, or was since the last call, and of `more`. Cheap: for every few
    /// seconds.
    /// The alarm that comes from it can be committed although the disk is full: the refused write gives up the ballast,
    /// which is room for thousands of alarms.
    #[must_use]
    pub fn trouble(&self, more: Option<(Severity, String)>) -> Option<(Severity, String)> {
        let disk = match self.disk.worst_level() {
            DiskLevel::Ample => None,
            DiskLevel::Low => Some((
                Severity::Warning,
                "its disk is nearly full, and the traces of judged throws are dropped. Free some space",
            )),
            DiskLevel::Full => {
                Some((Severity::Critical, "its disk is full, and writes are refused. Free some space now"))
            }
            DiskLevel::Failing => Some((
                Severity::Critical,
                "writing to its disk fails, and what arrives cannot be stored. Check the disk",
            )),
        };
        let disk = disk.map(|(severity, said)| (severity, said.to_owned()));
        let set_aside = self.place.set_aside_before().map(|file| {
            let saved = Place::saved_from(&file);
            let saved = saved.unwrap_or_else(|| "what it held is not in the history".to_owned());
            let said = format!(
                "its database was broken and was set aside as {}; {saved}. Keep that file for someone who can recover \
                 more, and move it elsewhere",
                file.display()
            );
            (Severity::Critical, said)
        });
        let replaced = self.disk.replaced().map(|mended| {
            let file = self.path().display();
            let said = if mended {
                format!(
                    "the file of its database was deleted or replaced while it ran; it wrote {file} anew, with everything. \
                     A file that stood there instead is now {file}-replaced-…. Find out who did that"
                )
            } else {
                format!("the file {file} of its database was deleted or replaced while it runs, and cannot be written anew")
            };
            (Severity::Critical, said)
        });
        let dropped = self.disk.dropped_pending.shown().map(|throws| {
            let said = format!(
                "{throws} throws were dropped before they were judged: its database holds store.max_size_mib of them, \
                 mostly of one machine. Look which logger sends so much"
            );
            (Severity::Critical, said)
        });
        let all: Vec<(Severity, String)> =
            disk.into_iter().chain(set_aside).chain(replaced).chain(dropped).chain(more).collect();
        let severity = all.iter().map(|(severity, _)| *severity).max()?;
        let said: Vec<&str> = all.iter().map(|(_, said)| said.as_str()).collect();
        Some((severity, format!("pointsd loses data: {}.", said.join("; "))))
    }
}
