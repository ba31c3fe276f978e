//! Gauges: quantities of a throw beside the coefficients, such as travel, resistance and duration. Each is compared
//! with its normal value in the direction, as the logarithm of the ratio or as a difference. Errors of sensors, clock
//! and supply change the gauges in other ways than faults of parts, which distinguishes the two.

mod circuit;
mod end;
mod features;
mod gauge;
mod levels;
mod normal;
mod offset;
mod side_watch;
mod start;
mod supply;
mod travel;

pub(super) use circuit::{AtStart, BackEmf, Circuit, ShownBy};
pub(super) use end::judge_end;
pub(super) use features::{FeatureWatch, RAIN_PCT, SLOW_FROM, may_rain_last};
pub(super) use gauge::Gauge;
pub(super) use levels::{GaugeChange, Gauges};
pub(super) use side_watch::SideWatch;
pub(super) use start::StartWatch;
pub(super) use supply::dry_rise;
pub(super) use travel::judge_travel;

use self::{
    gauge::{Values, heat, values},
    levels::{by_side, mean},
    normal::{Normal, sd_of_mean},
};
