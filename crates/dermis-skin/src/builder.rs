//! Skins made in code, in a line or two instead of a skin file.

use dermis_tomo::mesh::Point;

use crate::backend::MOST_PAIRS;
use crate::backend::{Backend, DrivePattern, DrivenChannels, MeasurePattern, ReadingOrder, Reads, Wiring};
use crate::channel_list::{ChannelList, ListedChannel};
use crate::check::Checker;
use crate::damage::DamageSettings;
use crate::electronics::Electronics;
use crate::error::Error;
use crate::frontend::{Electrodes, Frontend, Shape};
use crate::health::HealthSettings;
use crate::imaging::{GainMatch, Imaging};
use crate::layer::{Layer, SheetLayer};
use crate::skin::{Modality, Skin};
use crate::tolerances::Tolerances;
use crate::touch::TouchSettings;
use crate::twin::TwinSettings;

/// Minimum number of electrodes that stand in for unknown ones.
const FEWEST_STAND_INS: usize = 8;

impl SheetLayer {
    /// A gel with this thickness and conductivity that thins under pressure, with a modulus of 100 kPa.
    pub fn gel(thickness_mm: f64, conductivity_s_per_m: f64) -> Self {
        Self {
            thickness_mm,
            conductivity_s_per_m,
            pressure_percent_per_kpa: 0.0,
            gauge_factor: 1.0,
            modulus_kpa: 100.0,
            smoothing_mm: None,
            memory: None,
        }
    }
}

impl Skin {
    /// A skin with electrodes and this outline and layer: 16 electrodes around the rim, adjacent drive and
    /// measurement, 1 mA. [`Skin::checked`] checks that it makes sense.
    pub fn new(name: &str, shape: Shape, layer: Layer) -> Self {
        let polarity = layer.polarity();
        let gain = if matches!(layer, Layer::Liquid(_)) { GainMatch::Channel } else { GainMatch::Global };
        let skin = Self {
            name: name.to_string(),
            title: String::new(),
            modality: Modality::Eit,
            frontend: Frontend {
                shape,
                bend: None,
                layer,
                electrodes: Electrodes::default(),
                contact_impedance_ohm_m2: 1e-4,
                coils: None,
                elements: None,
            },
            backend: Backend {
                instrument: String::new(),
                current_ma: 1.0,
                frequency_khz: None,
                channels: None,
                drive: DrivePattern::Adjacent,
                measure: MeasurePattern::Adjacent,
                order: ReadingOrder::default(),
                driven: DrivenChannels::default(),
                reads: Reads::default(),
                differences: false,
                wiring: Wiring::default(),
                circuit: None,
                frames_per_s: None,
                send: None,
                electronics: Electronics::default(),
            },
            imaging: Imaging { polarity, gain, ..Imaging::default() },
            touch: TouchSettings::default(),
            health: HealthSettings::default(),
            damage: DamageSettings::default(),
            guard: None,
            tolerances: Tolerances::default(),
            twin: TwinSettings::default(),
            mount: None,
        };
        let width_mm = 0.4e3 * skin.frontend.shape.outline().perimeter_m() / 16.0;
        skin.with_rim_electrodes(16, width_mm.min(10.0))
    }

    /// A skin of which only the outline and the number of channels are known. Placeholder electrodes and pairs give
    /// every part of dermis something to count; the readings are learnt from pokes.
    ///
    /// # Errors
    /// Fails if there are no channels, or more than can be listed as pairs.
    pub fn of_channels(name: &str, shape: Shape, channels: usize) -> Result<Self, Error> {
        if !(1..=MOST_PAIRS).contains(&channels) {
            let checker = Checker { file: name };
            return Err(checker.refused("channels", channels, format!("1 to {MOST_PAIRS}")));
        }
        let count = (FEWEST_STAND_INS..).find(|count| count * (count - 1) / 2 >= channels).unwrap_or(FEWEST_STAND_INS);
        let all = 1..=count as u32;
        let pairs = all.clone().flat_map(|a| all.clone().filter(move |b| *b > a).map(move |b| [a, b]));
        let width_mm = 0.2e3 * shape.outline().perimeter_m() / count as f64;
        let mut skin = Self::new(name, shape, Layer::Sheet(SheetLayer::gel(1.0, 1.0)))
            .with_rim_electrodes(count, width_mm)
            .with_patterns(DrivePattern::Pairs(vec![[1, 2]]), MeasurePattern::Pairs(pairs.take(channels).collect()));
        skin.backend.driven = DrivenChannels::Keep;
        skin.backend.wiring = Wiring::Unknown;
        skin.health.watch = false;
        skin.checked()
    }

    /// A rectangle, in millimetres; see [`Skin::new`].
    pub fn rectangle(name: &str, width_mm: f64, height_mm: f64, layer: Layer) -> Self {
        Self::new(name, Shape::Rectangle { width_mm, height_mm }, layer)
    }

    /// A disc, in millimetres; see [`Skin::new`].
    pub fn disc(name: &str, diameter_mm: f64, layer: Layer) -> Self {
        Self::new(name, Shape::Disc { diameter_mm }, layer)
    }

    /// A polygon, in millimetres; see [`Skin::new`].
    pub fn polygon(name: &str, outer_mm: Vec<Point>, holes_mm: Vec<Vec<Point>>, layer: Layer) -> Self {
        Self::new(name, Shape::Polygon { outer_mm, holes_mm }, layer)
    }

    /// Puts `count` electrodes of width `width_mm` at even distances around the rim.
    pub fn with_rim_electrodes(self, count: usize, width_mm: f64) -> Self {
        self.with_electrodes(Electrodes::Rim { count, width_mm, start_deg: None, clockwise: false })
    }

    /// Replaces the electrodes.
    pub fn with_electrodes(mut self, electrodes: Electrodes) -> Self {
        self.frontend.electrodes = electrodes;
        self
    }

    /// Replaces the stimulation and measurement patterns.
    pub fn with_patterns(mut self, drive: DrivePattern, measure: MeasurePattern) -> Self {
        self.backend.channels = None;
        (self.backend.drive, self.backend.measure) = (drive, measure);
        self
    }

    /// Replaces the channels, in this order. Electrodes are numbered from 1.
    pub fn with_channels(mut self, channels: Vec<ListedChannel>) -> Self {
        self.backend.channels = Some(ChannelList::Listed(channels));
        (self.backend.drive, self.backend.measure) = (DrivePattern::Listed, MeasurePattern::Listed);
        (self.backend.order, self.backend.driven) = (ReadingOrder::default(), DrivenChannels::default());
        self
    }
}
