//! Gauges: quantities of a throw beside the coefficients (travel, back-EMF constant, resistance, duration, voltage,
//! inrush, running current, charge, no-load speed, start, current at rest, middle, air temperature, rise at the end).
//! Each gauge is used as the logarithm of its ratio to the normal value of the direction, but delay of the start,
//! current at rest, middle, temperature and rise at the end as a difference. Errors of sensors, clock and supply change
//! the gauges in other ways than faults of parts, which distinguishes the two.

mod circuit;
mod end;
mod features;
mod gauge;
mod levels;
mod normal;
mod offset;
mod start;
mod supply;
mod travel;

pub(super) use circuit::{AtStart, BackEmf, Circuit, ShownBy};
pub(super) use end::EndWatch;
pub(super) use features::{FeatureWatch, RAIN_HOURS, RAIN_PCT, SLOW_FROM};
pub(super) use gauge::Gauge;
pub(super) use levels::{GaugeChange, Gauges};
pub(super) use start::StartWatch;
pub(super) use supply::dry_rise;
pub(super) use travel::TravelWatch;

use self::{
    gauge::{Values, heat, values},
    levels::{by_side, mean},
    normal::{Normal, sd_of_mean},
};
