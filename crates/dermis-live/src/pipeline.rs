//! The live pipeline: frame, channels, baseline, image, touches. Typed stages called one after another; after start-up
//! nothing is allocated per frame, but where touches are fitted as contacts or elements are solved for. It knows
//! neither where frames come from nor where results go. Stages know nothing of each other: those that look at health,
//! damage and classes return what follows, and it is applied here.

mod stage_latencies;
mod state;

use std::time::Duration;

use dermis_device::{Frame, FrameTable, Layout};
use dermis_learn::Model;
use dermis_skin::CircuitChoice;
use dermis_tomo::inverse::check_hyperparameter;
use dermis_touch::force::ForceCalibration;
use dermis_touch::health::Health;
use dermis_touch::{
    Baseline, BaselineChange, BaselineParams, BaselineState, DriftCompensation, Load, ReferenceOrigin, ReferenceRecord,
    TareGuard,
};

use crate::Error;
use crate::beside::Beside;
use crate::calibration::{Calibration, LoadQuantity, check_wiring};
use crate::channels::ChannelReader;
use crate::clock::FrameClock;
use crate::instant::Instant;
