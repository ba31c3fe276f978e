//! Statistics of short series of throws.

mod autoregression;
mod correlation;
mod counts;
mod last_values;
mod level;
mod persistence;
mod regression;
mod robust;
mod scatter;
mod single;
mod sparse_values;
pub(super) mod sym3;

pub(super) use autoregression::ln_sum;
pub use correlation::Correlation;
pub(super) use counts::{LONGEST_WINDOW, WINDOWS, is_default, streak};
pub(super) use last_values::LastValues;
pub(super) use level::{Level, percent};
pub(super) use regression::Series;
pub(super) use robust::{centre_and_sd, clipped_mean, median, moving_range_sd, skewed_sd};
pub(super) use scatter::{Factor, Noise, SLOW_LAG1, Scatter, inflation, serial_inflation};
pub(super) use single::{to_f32, to_rounded_f32};
pub(super) use sparse_values::SparseValues;
pub(super) use sym3::Sym3;
