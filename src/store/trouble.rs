//! What keeps the store from keeping everything, in words for an alarm.

use super::{DiskLevel, Store};
use crate::diagnose::Severity;

impl Store {
    /// The worst of what is wrong, or was since this was asked last, and all of it in words. Cheap: for every few seconds.
    /// The alarm that comes from it can be committed although the disk is full: the refused write gives up the ballast,
    /// which is room for thousands of alarms.
    #[must_use]
    pub fn trouble(&self) -> Option<(Severity, String)> {
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
            let said = format!(
                "its database was broken and was set aside as {}: what it held is not in the history. Keep that file \
                 for someone who can recover it, and move it elsewhere",
                file.display()
            );
            (Severity::Critical, said)
        });
        let all: Vec<(Severity, String)> = disk.into_iter().chain(set_aside).collect();
        let severity = all.iter().map(|(severity, _)| *severity).max()?;
        let said: Vec<&str> = all.iter().map(|(_, said)| said.as_str()).collect();
        Some((severity, format!("pointsd loses data: {}.", said.join("; "))))
    }
}
