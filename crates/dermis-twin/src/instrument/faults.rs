//! Instrument faults, seeded and switchable at run time.
//!
//! Electrodes: a channel whose measuring pattern includes an open electrode floats and reads a uniformly distributed
//! voltage over full scale. A stimulation through an open electrode carries no current, so all its channels read 0. A
//! shorted pair takes the whole current of a stimulation across it (0 on all its channels) and equalises the two
//! potentials: a channel across it reads 0, and a channel on one of the two electrodes reads the mean of itself and
//! the same stimulation's channel on the other, if there is one. The redirection of current inside the skin by a
//! short is not modelled. A dead coil neither generates nor senses a field: all its channels read 0.

use dermis_tomo::eit::Protocol;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use super::noise::normal;
use crate::error::{TwinError, check};

/// A fault; see the module for the effect of electrode faults.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum Fault {
    /// An electrode without contact.
    OpenElectrode {
        /// Index from 0.
        electrode: u32,
    },
    /// Two electrodes connected by a wire.
    ShortedPair {
        /// Indices from 0.
        electrodes: [u32; 2],
    },
    /// A channel stuck at one value.
    StuckChannel {
        /// Index from 0.
        channel: usize,
        /// Constant reading, volts.
        value_v: f64,
    },
    /// A channel with noise on top of the common noise.
    NoisyChannel {
        /// Index from 0.
        channel: usize,
        /// Standard deviation of the extra noise, volts.
        deviation_v: f64,
    },
    /// A coil with a broken winding or wire.
    DeadCoil {
        /// Index from 0.
        coil: u32,
    },
    /// Frames lost in transit.
    DroppedFrames {
        /// Probability per frame, 0 to 1.
        probability: f64,
    },
    /// Frames that repeat the previous one.
    DuplicatedFrames {
        /// Probability per frame, 0 to 1.
        probability: f64,
    },
}

/// Fate of a frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum FrameFate {
    /// It arrives.
    #[default]
    Delivered,
    /// It is lost; its readings must not be used.
    Dropped,
    /// Its readings are those of the last frame that arrived.
    Duplicated,
}

/// Active faults. They have their own random numbers, so the noise is the same with and without them.
#[derive(Clone, Debug)]
pub(super) struct Faults {
    list: Vec<Fault>,
    protocol: Option<Protocol>,
    /// True if the protocol is for coils.
    coils: bool,
    channels: usize,
    random: ChaCha8Rng,
    floating: Vec<usize>,
    dead: Vec<usize>,
    /// A channel and the channel it is averaged with.
    tied: Vec<(usize, usize)>,
    /// The last delivered frame: real parts, then imaginary parts if any.
    previous: Vec<f64>,
    fate: FrameFate,
}

impl Faults {
    pub fn new(channels: usize, seed: u64) -> Self {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        random.set_stream(1);
        Self {
            list: Vec::new(),
            protocol: None,
            coils: false,
            channels,
            random,
            floating: Vec::new(),
            dead: Vec::new(),
            tied: Vec::new(),
            previous: Vec::new(),
            fate: FrameFate::Delivered,
        }
    }

    pub fn list(&self) -> &[Fault] {
        &self.list
    }

    pub fn fate(&self) -> FrameFate {
        self.fate
    }

    pub fn set_protocol(&mut self, protocol: &Protocol) -> Result<(), TwinError> {
        let (got, channels) = (protocol.channel_count() as f64, self.channels as f64);
        check("channels of the instrument's protocol", got, channels, channels, "as many as the instrument reads")?;
        self.protocol = Some(protocol.clone());
        Ok(())
    }

    pub fn set_coils(&mut self, pairs: &Protocol) -> Result<(), TwinError> {
        self.coils = true;
        self.set_protocol(pairs)
    }

    pub fn set(&mut self, faults: Vec<Fault>) -> Result<(), TwinError> {
        self.check_all(&faults)?;
        self.floating.clear();
        self.dead.clear();
        self.tied.clear();
        // A frame read before these faults must not be repeated by them.
        self.previous.clear();
        for fault in &faults {
            match *fault {
                Fault::OpenElectrode { electrode } => self.open(electrode),
                Fault::ShortedPair { electrodes: [a, b] } => self.short(a, b),
                Fault::DeadCoil { coil } => self.silence(coil),
                _ => {}
            }
        }
        self.list = faults;
        Ok(())
    }

    pub fn check_all(&self, faults: &[Fault]) -> Result<(), TwinError> {
        faults.iter().try_for_each(|fault| self.check(fault))
    }

    fn check(&self, fault: &Fault) -> Result<(), TwinError> {
        let count = |coils: bool| match &self.protocol {
            Some(protocol) if self.coils == coils => protocol.electrode_count() as f64,
            _ => 0.0,
        };
        let electrode = |index: u32| {
            let expected = "an electrode of the instrument's protocol";
            check("faulty electrode", f64::from(index), 0.0, count(false) - 1.0, expected)
        };
        let exists = |field: &'static str, channel: usize| {
            check(field, channel as f64, 0.0, self.channels as f64 - 1.0, "a channel that exists")
        };
        match *fault {
            Fault::OpenElectrode { electrode: index } => electrode(index),
            Fault::ShortedPair { electrodes: [a, b] } => {
                electrode(a)?;
                electrode(b)?;
                check("distance of shorted electrodes", f64::from(a.abs_diff(b)), 1.0, f64::MAX, "two electrodes")
            }
            Fault::StuckChannel { channel, value_v } => {
                exists("stuck channel", channel)?;
                check("stuck value_v", value_v, f64::MIN, f64::MAX, "finite")
            }
            Fault::NoisyChannel { channel, deviation_v } => {
                exists("noisy channel", channel)?;
                check("noisy channel's deviation_v", deviation_v, 0.0, f64::MAX, "zero or more, finite")
            }
            Fault::DeadCoil { coil } => {
                check("dead coil", f64::from(coil), 0.0, count(true) - 1.0, "a coil of the instrument")
            }
            Fault::DroppedFrames { probability } | Fault::DuplicatedFrames { probability } => {
                check("fault probability", probability, 0.0, 1.0, "0 to 1")
            }
        }
    }

    fn open(&mut self, electrode: u32) {
        let Some(protocol) = &self.protocol else { return };
        for (channel, measurement) in protocol.measurements().iter().enumerate() {
            if protocol.patterns()[measurement.pattern as usize].touches(electrode) {
                self.floating.push(channel);
            } else if protocol.stimulations()[measurement.stimulation as usize].touches(electrode) {
                self.dead.push(channel);
            }
        }
    }

    fn silence(&mut self, coil: u32) {
        let Some(protocol) = &self.protocol else { return };
        for (channel, measurement) in protocol.measurements().iter().enumerate() {
            let [stimulation, pattern] = [measurement.stimulation, measurement.pattern].map(|index| index as usize);
            if protocol.stimulations()[stimulation].touches(coil) || protocol.patterns()[pattern].touches(coil) {
                self.dead.push(channel);
            }
        }
    }

    fn short(&mut self, a: u32, b: u32) {
        let Some(protocol) = &self.protocol else { return };
        let measurements = protocol.measurements();
        let swap = |electrode: u32| match electrode {
            e if e == a => b,
            e if e == b => a,
            e => e,
        };
        for (channel, measurement) in measurements.iter().enumerate() {
            let drive = &protocol.stimulations()[measurement.stimulation as usize];
            let pattern = &protocol.patterns()[measurement.pattern as usize];
            let across = pattern.touches(a) && pattern.touches(b) && pattern.entries().len() == 2;
            if across || (drive.touches(a) && drive.touches(b)) {
                self.dead.push(channel);
            } else {
                let mut swapped: Vec<(u32, f64)> = pattern.entries().iter().map(|&(e, w)| (swap(e), w)).collect();
                swapped.sort_by_key(|entry| entry.0);
                let twin = measurements.iter().position(|other| {
                    other.stimulation == measurement.stimulation
                        && protocol.patterns()[other.pattern as usize].entries() == swapped
                });
                // Each pair once, from its lower channel.
                self.tied.extend(twin.filter(|&twin| twin > channel).map(|twin| (channel, twin)));
            }
        }
    }

    /// Applies electrode faults to true voltages.
    pub fn of_electrodes(&mut self, full_scale_v: f64, voltages_v: &mut [f64]) {
        for &(one, other) in &self.tied {
            let mean = 0.5 * (voltages_v[one] + voltages_v[other]);
            (voltages_v[one], voltages_v[other]) = (mean, mean);
        }
        for &channel in &self.dead {
            voltages_v[channel] = 0.0;
        }
        for &channel in &self.floating {
            voltages_v[channel] = full_scale_v * self.random.random_range(-1.0..1.0);
        }
    }

    /// Applies frame faults to readings; imaginary parts may be empty.
    pub fn of_frames(&mut self, readings_v: &mut [f64], imaginary_v: &mut [f64]) {
        self.fate = FrameFate::Delivered;
        for fault in &self.list {
            match *fault {
                Fault::StuckChannel { channel, value_v } => {
                    readings_v[channel] = value_v;
                    imaginary_v.iter_mut().skip(channel).take(1).for_each(|value| *value = 0.0);
                }
                Fault::NoisyChannel { channel, deviation_v } => {
                    let mut noise = || deviation_v * normal(&mut self.random);
                    readings_v[channel] += noise();
                    imaginary_v.iter_mut().skip(channel).take(1).for_each(|value| *value += noise());
                }
                Fault::DroppedFrames { probability } if self.random.random_bool(probability) => {
                    self.fate = FrameFate::Dropped;
                }
                Fault::DuplicatedFrames { probability }
                    if self.random.random_bool(probability)
                        && self.fate == FrameFate::Delivered
                        && !self.previous.is_empty() =>
                {
                    self.fate = FrameFate::Duplicated;
                }
                _ => {}
            }
        }
        match self.fate {
            FrameFate::Delivered if !self.list.is_empty() => {
                self.previous.clear();
                self.previous.extend_from_slice(readings_v);
                self.previous.extend_from_slice(imaginary_v);
            }
            FrameFate::Duplicated => {
                let (real, imaginary) = self.previous.split_at(readings_v.len());
                readings_v.copy_from_slice(real);
                imaginary_v.copy_from_slice(imaginary);
            }
            _ => {}
        }
    }
}
