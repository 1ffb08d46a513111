//! The twins of the built-in skins: which twin stands for a skin file, how hard people may press on it, and what it
//! demonstrates by itself.

use dermis_twin::instrument::{InstrumentOptions, Reading};
use dermis_twin::scene::Script;
use dermis_twin::{EmArray, EmElement, EmOptions, Frontend, HealingSquareOptions, IonicOptions, PiezoOptions, Twin};

use crate::Error;
use crate::skin::{DrivePattern, Reads, Skin};

/// A twin of any skin.
pub type AnyTwin = Twin<Box<dyn Frontend>>;

/// Names of the skins that have a twin.
pub const TWIN_NAMES: [&str; 9] = [
    "healing-square",
    "ionic-disc",
    "ionic-square",
    "piezo-square",
    "piezo-disc",
    "piezo-cylinder",
    "em-8",
    "em-16-circular",
    "em-16-square",
];

/// What people may press with: least and most, and where sliders begin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PressRange {
    /// Radius of the indenter.
    pub radius_m: [f64; 2],
    /// Pressure under it.
    pub pressure_pa: [f64; 2],
    /// Radius at the start.
    pub initial_radius_m: f64,
    /// Pressure at the start.
    pub initial_pressure_pa: f64,
}

/// A twin with what goes with it.
#[derive(Debug)]
pub struct TwinKit {
    /// The twin, at rest.
    pub twin: AnyTwin,
    /// What people may press with.
    pub press: PressRange,
    /// What touches it by itself when nobody does.
    pub demo: Script,
}

/// Indenters of 20 mm and 80 kPa, with which paper H tested, in the middle of the sliders.
const SANDWICH: PressRange = PressRange {
    radius_m: [2e-3, 30e-3],
    pressure_pa: [0.0, 200e3],
    initial_radius_m: 10e-3,
    initial_pressure_pa: 80e3,
};

/// Discs of 20 mm under up to two dozen weights of 6.5 g, of which paper I used nine (1.8 kPa).
const LIQUID: PressRange = PressRange {
    radius_m: [4e-3, 40e-3],
    pressure_pa: [0.0, 4e3],
    initial_radius_m: 10e-3,
    initial_pressure_pa: 1.2e3,
};

/// A finger's width; the paper's heaviest weight on its 22 mm indenter makes 0.8 kPa, a finger ten and more.
const PATCHES: PressRange =
    PressRange { radius_m: [3e-3, 30e-3], pressure_pa: [0.0, 10e3], initial_radius_m: 11e-3, initial_pressure_pa: 3e3 };

/// A fingertip over one element of 10 mm on sponge, up to about 7 N.
const SPONGE: PressRange =
    PressRange { radius_m: [3e-3, 30e-3], pressure_pa: [0.0, 25e3], initial_radius_m: 9e-3, initial_pressure_pa: 10e3 };

/// Fingers over springs 35 mm apart.
const SPRINGS: PressRange =
    PressRange { radius_m: [5e-3, 60e-3], pressure_pa: [0.0, 20e3], initial_radius_m: 15e-3, initial_pressure_pa: 8e3 };

impl TwinKit {
    /// The twin of a skin.
    ///
    /// # Errors
    /// A skin without twin, one that cannot be made, faults of channels that it does not have.
    pub fn of(skin: &Skin) -> Result<Self, Error> {
        let mut kit = Self::sound(skin)?;
        kit.twin.set_faults(skin.twin.timed_faults())?;
        kit.twin.set_treatments(skin.twin.timed_treatments())?;
        Ok(kit)
    }

    /// The same without the faults and treatments that the skin file asks for.
    fn sound(skin: &Skin) -> Result<Self, Error> {
        match skin.name.as_str() {
            "healing-square" => Self::sandwich(HealingSquareOptions::default(), skin),
            "ionic-disc" => Self::ionic(IonicOptions::disc(), skin, 1.7),
            "ionic-square" => Self::ionic(IonicOptions::square(), skin, 2.1),
            "piezo-square" => Self::piezo(PiezoOptions::square(), skin, 1.5),
            "piezo-disc" => Self::piezo(PiezoOptions::disc(), skin, 1.2),
            "piezo-cylinder" => Self::piezo(PiezoOptions::cylinder(), skin, 1.5),
            "em-8" => Self::em(skin, SPONGE, 1.0),
            "em-16-circular" | "em-16-square" => Self::em(skin, SPRINGS, 2.8),
            other => Err(Error::Frames {
                what: "twin".into(),
                expected: format!("a skin that has one ({})", TWIN_NAMES.join(", ")),
                got: other.to_string(),
            }),
        }
    }

    /// A twin with the sandwich's demonstration, `length` times as wide and as much softer as what it is pressed with.
    fn pressed(twin: AnyTwin, press: PressRange, length: f64) -> Self {
        let softness = press.initial_pressure_pa / SANDWICH.initial_pressure_pa;
        Self { twin, press, demo: Script::demo().scaled(length, softness) }
    }

    fn sandwich(mut options: HealingSquareOptions, skin: &Skin) -> Result<Self, Error> {
        options.instrument = as_the_skin_reads(options.instrument, skin);
        options.seed = skin.twin.seed.unwrap_or(options.seed);
        Ok(Self { twin: Twin::healing_square(&options)?.boxed(), press: SANDWICH, demo: Script::demo() })
    }

    /// A liquid skin, `length` times as large as the sandwich and far softer.
    fn ionic(mut options: IonicOptions, skin: &Skin, length: f64) -> Result<Self, Error> {
        options.skip = if let DrivePattern::Skip(skip) = skin.backend.drive { skip } else { 0 };
        options.instrument = as_the_skin_reads(options.instrument, skin);
        options.seed = skin.twin.seed.unwrap_or(options.seed);
        Ok(Self::pressed(Twin::ionic(&options)?.boxed(), LIQUID, length))
    }

    /// Elements over coils, `length` times as large as the sandwich.
    fn em(skin: &Skin, press: PressRange, length: f64) -> Result<Self, Error> {
        Ok(Self::pressed(Twin::em(&em_options(skin)?)?.boxed(), press, length))
    }

    /// A skin of loose patches, `length` times as large as the sandwich.
    fn piezo(mut options: PiezoOptions, skin: &Skin, length: f64) -> Result<Self, Error> {
        options.instrument = as_the_skin_reads(options.instrument, skin);
        options.seed = skin.twin.seed.unwrap_or(options.seed);
        Ok(Self::pressed(Twin::piezo(&options)?.boxed(), PATCHES, length))
    }
}

/// Parameters of the twin of a skin of magnetic induction: coils, elements, current and frequency as the file says, its
/// elements' answer from edge elements ([`crate::bodies`]); mechanics and noise those of the published skin of that array.
///
/// # Errors
/// A skin without coils and elements, a body that cannot be computed.
pub fn em_options(skin: &Skin) -> Result<EmOptions, Error> {
    let model = skin.magnetic()?;
    let mut options = match skin.frontend.coils.map(|coils| coils.array) {
        Some(EmArray::Em16Circular) => EmOptions::em_16_circular(),
        Some(EmArray::Em16Square) => EmOptions::em_16_square(),
        Some(EmArray::Em8) | None => EmOptions::em_8(),
    };
    let elements = model.elements;
    options.plate_m = skin.frontend.coils.and_then(|coils| coils.shield_mm).map(|z_mm| z_mm * 1e-3);
    options.per_side = elements.per_side;
    (options.pitch_m, options.rest_m) = (elements.pitch_mm / 1e3, elements.rest_mm / 1e3);
    options.springs.limit_m = elements.travel_mm / 1e3;
    options.element = EmElement::Body(model.element.body(model.frequency_hz)?);
    options.frequency_hz = model.frequency_hz;
    options.current_a = skin.backend.current_ma / 1e3;
    options.frame_rate_hz = skin.backend.frames_per_s.unwrap_or(options.frame_rate_hz);
    options.instrument = as_the_skin_reads(options.instrument, skin);
    options.seed = skin.twin.seed.unwrap_or(options.seed);
    Ok(options)
}

/// An instrument that reports what the skin file says its backend reads.
fn as_the_skin_reads(instrument: InstrumentOptions, skin: &Skin) -> InstrumentOptions {
    let reading = match skin.backend.reads {
        Reads::Signed => Reading::Signed,
        Reads::Magnitude => Reading::Magnitude,
        Reads::Complex => Reading::Complex,
    };
    InstrumentOptions { reading, phase_error_rad: skin.twin.phase_error_deg.to_radians(), ..instrument }
}
