//! Statistics of short series of throws.

pub(super) mod autoregression;
pub(super) mod correlation;
pub(super) mod counts;
pub(super) mod last;
pub(super) mod level;
pub(super) mod persistence;
pub(super) mod rare;
pub(super) mod regression;
pub(super) mod robust;
pub(super) mod scatter;
pub(super) mod sym3;
