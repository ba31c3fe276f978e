//! Numbers of consecutive throws: the windows of the detection, and counts.

/// Length of the longest window of the detection \[throws\].
pub(crate) const LONGEST_WINDOW: u32 = 24;

/// Lengths of the windows of the detection \[throws\].
pub(crate) const WINDOWS: [usize; 4] = [3, 6, 12, LONGEST_WINDOW as usize];

/// Whether a value is the default one, as most counters are: snapshots leave it out.
pub(crate) fn is_default<T: Default + PartialEq>(value: &T) -> bool {
    *value == T::default()
}

/// Counts consecutive throws in which something holds.
pub(crate) fn streak(count: &mut u32, holds: bool) {
    *count = if holds { count.saturating_add(1) } else { 0 };
}
