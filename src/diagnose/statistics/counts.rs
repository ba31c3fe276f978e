//! Numbers of consecutive throws: the windows of the detection, and counts.

/// Lengths of the windows of the detection \[throws\].
pub(crate) const WINDOWS: [usize; 4] = [3, 6, 12, 24];
/// Length of the longest window.
pub(crate) const LONGEST_WINDOW: u32 = 24;
const _: () = assert!(LONGEST_WINDOW as usize == WINDOWS[3], "the same length, in another type");

/// Counts consecutive throws in which something holds.
pub(crate) fn streak(count: &mut u32, holds: bool) {
    *count = if holds { count.saturating_add(1) } else { 0 };
}
