//! The skin file: what is sewn on the robot (`frontend`), what reads it (`backend`), and how images and touches are made
//! of it. TOML with units in every key; unknown keys are errors that show their place.

mod build;
mod builtin;
mod choice;
mod damage;
mod health;
mod magnetic;
mod parts;
mod refinement;
mod twin;

pub use build::SkinBody;
pub use builtin::{BUILTIN_NAMES, builtin_text};
pub use damage::DamageSettings;
pub use health::HealthSettings;
pub(crate) use magnetic::ELEMENT_WIDTH;
pub use magnetic::{Coils, ElementShape, Elements};
pub use refinement::Refinement;
pub use twin::{NoisyChannel, StuckChannel, TwinAction, TwinFaults, TwinSettings, TwinTreatment};

use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::Error;

/// More electrodes than any multiplexer has are a typing error.
const MOST_ELECTRODES: usize = 1024;

/// A whole skin file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Skin {
    /// Short name, as on the command line.
    pub name: String,
    /// One line for people.
    #[serde(default)]
    pub title: String,
    /// What physics reads it.
    pub modality: Modality,
    /// Geometry, material, electrodes.
    pub frontend: Frontend,
    /// Instrument and protocol.
    pub backend: Backend,
    /// From difference data to images.
    #[serde(default)]
    pub imaging: Imaging,
    /// From images to touches.
    #[serde(default)]
    pub touch: TouchSettings,
    /// How its channels are watched.
    #[serde(default, skip_serializing_if = "HealthSettings::is_default")]
    pub health: HealthSettings,
    /// How damage is told from touch.
    #[serde(default, skip_serializing_if = "DamageSettings::is_default")]
    pub damage: DamageSettings,
    /// Its twin.
    #[serde(default, skip_serializing_if = "is_default")]
    pub twin: TwinSettings,
}

fn is_default(twin: &TwinSettings) -> bool {
    *twin == TwinSettings::default()
}

/// What physics reads a skin.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Modality {
    /// Electrical impedance tomography.
    Eit,
    /// Magnetic induction tomography.
    Mit,
}

impl Modality {
    /// As in skin files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Eit => "eit",
            Self::Mit => "mit",
        }
    }

    /// What the values of its images are.
    pub fn image_quantity(self) -> &'static str {
        match self {
            Self::Eit => "relative conductivity change",
            Self::Mit => "share of the elements' travel",
        }
    }
}

/// What is sewn on the robot.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Frontend {
    /// Outline, laid flat.
    pub shape: Shape,
    /// What the sheet is bent on; flat where left out. Positions are those of the sheet laid flat.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub bend: Option<Bend>,
    /// The conducting layer.
    pub layer: Layer,
    /// Where the electrodes are.
    #[serde(default, skip_serializing_if = "Electrodes::are_none")]
    pub electrodes: Electrodes,
    /// Specific contact impedance of every electrode, ohm.m^2.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub contact_impedance_ohm_m2: f64,
    /// The coils of magnetic induction, in place of electrodes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub coils: Option<Coils>,
    /// The conducting elements over the coils.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub elements: Option<Elements>,
}

fn is_zero(value: &f64) -> bool {
    *value == 0.0
}

/// Outline of a skin, centred at the origin.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum Shape {
    /// Round.
    Disc {
        /// Diameter.
        diameter_mm: f64,
    },
    /// Square.
    Square {
        /// Side.
        side_mm: f64,
    },
    /// Rectangle.
    Rectangle {
        /// Along x.
        width_mm: f64,
        /// Along y.
        height_mm: f64,
    },
    /// Any polygon, holes allowed.
    Polygon {
        /// Vertices of the rim.
        outer_mm: Vec<[f64; 2]>,
        /// Vertices of each hole.
        #[serde(default)]
        holes_mm: Vec<Vec<[f64; 2]>>,
    },
}

/// What a sheet is bent on, without stretching it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum Bend {
    /// A cylinder whose axis runs along y, behind the sheet.
    Cylinder {
        /// Its diameter.
        diameter_mm: f64,
    },
}

/// The conducting layer.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Layer {
    /// `sandwich`, `gel`, `liquid`, ...: a word that twins and learning select on.
    pub kind: String,
    /// Thickness, or depth of a liquid.
    pub thickness_mm: f64,
    /// Conductivity when nothing touches.
    pub conductivity_s_per_m: f64,
}

/// Electrodes of a skin; numbered from 1 in the order that the generator says.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum Electrodes {
    /// Evenly round the rim of a disc (or any outline, by arc length).
    Rim {
        /// How many.
        count: usize,
        /// Length of each along the rim.
        width_mm: f64,
        /// Angle of electrode 1, counter-clockwise from +x (on other outlines: position along the rim in these terms
        /// of a full turn).
        start_deg: f64,
        /// Numbered clockwise seen from the toucher.
        #[serde(default)]
        clockwise: bool,
    },
    /// Square pads under the sheet along the rim of a square, `per_side + 1` to a side counting both corners,
    /// counter-clockwise from the bottom left corner.
    RimPads {
        /// Intervals a side; `4 * per_side` pads in all.
        per_side: usize,
        /// Distance between neighbouring centres.
        pitch_mm: f64,
        /// Side of a pad.
        size_mm: f64,
    },
    /// Listed electrodes on the rim.
    RimList(Vec<RimElectrode>),
    /// Round pads under the sheet all over it: in the middles of an even division of a square or rectangle into rows and
    /// columns, on a disc at their image under the equal-area concentric map; row by row to and fro from the bottom left,
    /// so that neighbours in number are neighbours in place.
    PadGrid {
        /// Rows, and pads in a row.
        per_side: usize,
        /// Diameter of a pad.
        diameter_mm: f64,
    },
    /// Listed pads.
    Pads(Vec<Pad>),
}

impl Default for Electrodes {
    fn default() -> Self {
        Self::Pads(Vec::new())
    }
}

impl Electrodes {
    fn are_none(&self) -> bool {
        matches!(self, Self::Pads(pads) if pads.is_empty())
    }
}

/// One listed electrode on the rim.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RimElectrode {
    /// Angle of its middle, counter-clockwise from +x (on other outlines than discs: position along the rim in terms of
    /// a full turn).
    pub at_deg: f64,
    /// Length along the rim.
    pub width_mm: f64,
}

/// One listed pad under the sheet.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum Pad {
    /// Round pad.
    Circle {
        /// Centre.
        centre_mm: [f64; 2],
        /// Diameter.
        diameter_mm: f64,
    },
    /// Rectangular pad.
    Rectangle {
        /// Centre.
        centre_mm: [f64; 2],
        /// Along x.
        width_mm: f64,
        /// Along y.
        height_mm: f64,
    },
    /// A single node.
    Point {
        /// Where.
        at_mm: [f64; 2],
    },
}

/// Instrument and protocol.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Backend {
    /// Name of the instrument, for people.
    #[serde(default)]
    pub instrument: String,
    /// Current amplitude.
    pub current_ma: f64,
    /// Drive frequency.
    #[serde(default)]
    pub frequency_khz: Option<f64>,
    /// Which pairs drive.
    pub drive: DrivePattern,
    /// What is read for each.
    pub measure: MeasurePattern,
    /// Order of the readings of a drive.
    #[serde(default)]
    pub order: ReadingOrder,
    /// Channels that touch a driven electrode.
    #[serde(default)]
    pub driven: DrivenChannels,
    /// What a reading is.
    #[serde(default)]
    pub reads: Reads,
    /// What the readout does to the potentials, where it is not an ideal voltmeter.
    #[serde(default)]
    pub circuit: Option<Circuit>,
    /// Frames a second, where the instrument has a rate of its own.
    #[serde(default)]
    pub frames_per_s: Option<f64>,
}

/// A readout that loads the skin and reads a mixture of lines, see [`dermis_tomo::eit::ReadoutCircuit`]. Admittances to
/// ground are relative to the skin's sheet conductance.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Circuit {
    /// Admittance of the sink and of both measuring lines.
    pub load: f64,
    /// Admittance of every idle electrode.
    pub idle: f64,
    /// Weights of the positive, the negative and the sink line in a reading.
    pub reading: [f64; 3],
}

impl Circuit {
    pub(crate) fn readout(&self) -> dermis_tomo::eit::ReadoutCircuit {
        use dermis_tomo::eit::{CurrentReturn, Lines, ReadoutCircuit};
        let [plus, minus, sink] = self.reading;
        ReadoutCircuit {
            load: Lines { sink: self.load, plus: self.load, minus: self.load },
            idle: self.idle,
            reading: Lines { sink, plus, minus },
            current_return: CurrentReturn::Ground,
        }
    }
}

/// Drive patterns; electrodes are numbered from 1.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum DrivePattern {
    /// Pairs (k, k+1).
    Adjacent,
    /// Pairs (k, k+L/2).
    Opposite,
    /// Pairs (k, k+n+1).
    Skip(usize),
    /// Pairs (k, k+L/2-1).
    PseudoPolar,
    /// Cosines and sines over all electrodes.
    Trigonometric,
    /// Listed [sink, source].
    Pairs(Vec<[u32; 2]>),
    /// Coils, one after the other.
    EachCoil,
}

/// Measuring patterns; electrodes are numbered from 1.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum MeasurePattern {
    /// Pairs (j, j+1).
    Adjacent,
    /// Pairs (j, j+L/2).
    Opposite,
    /// Pairs (j, j+n+1).
    Skip(usize),
    /// Pairs (j, j+L/2-1).
    PseudoPolar,
    /// Every electrode against `mean`, `sink`, or an electrode number.
    SingleEnded(ReferenceChoice),
    /// Listed [plus, minus].
    Pairs(Vec<[u32; 2]>),
    /// Coils of higher number than the one that drives.
    HigherCoils,
}

/// Reference of single-ended readings.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ReferenceChoice {
    /// Mean of all electrodes.
    Mean,
    /// The electrode that sinks the current.
    Sink,
    /// One electrode, numbered from 1.
    Electrode(u32),
}

/// Order of the readings of one drive.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ReadingOrder {
    /// By electrode number.
    #[default]
    Absolute,
    /// From the drive pair on.
    Rotating,
}

/// Channels that touch a driven electrode.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum DrivenChannels {
    /// Not among the readings.
    #[default]
    Drop,
    /// Read like all others.
    Keep,
}

/// What a reading is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Reads {
    /// A signed voltage (in-phase).
    #[default]
    Signed,
    /// A rectified voltage: the sign is the model's.
    Magnitude,
    /// Real and imaginary parts: the component in phase with the baseline is used.
    Complex,
}

/// From difference data to images.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Imaging {
    /// Pixels along the longer side.
    pub grid: usize,
    /// Elements of the reconstruction's mesh.
    pub elements: usize,
    /// What is expected of an image.
    pub prior: PriorChoice,
    /// What images are solved for.
    pub solve: Solve,
    /// How lambda is found.
    pub hyperparameter: HyperparameterChoice,
    /// How much each channel counts.
    pub weights: WeightChoice,
    /// What the measured baseline is matched to the model by.
    pub gain: GainMatch,
    /// Which change of conductivity is shown as positive.
    pub polarity: Polarity,
    /// Steps that refine offline images of large contrasts; live images are linear in any case.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub refinement: Option<Refinement>,
}

impl Default for Imaging {
    fn default() -> Self {
        Self {
            grid: 64,
            elements: 4000,
            prior: PriorChoice::default(),
            solve: Solve::default(),
            hyperparameter: HyperparameterChoice::default(),
            weights: WeightChoice::default(),
            gain: GainMatch::default(),
            polarity: Polarity::default(),
            refinement: None,
        }
    }
}

/// What images are solved for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Solve {
    /// Pixels, by one linear operator.
    #[default]
    Pixels,
    /// The travel of every element of a magnetic induction skin, by a nonlinear fit.
    Heights,
}

/// Priors by name.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PriorChoice {
    /// Zeroth-order Tikhonov.
    Identity,
    /// Graph Laplacian of the pixels.
    Laplace,
    /// NOSER with this exponent.
    Noser(f64),
    /// Gaussian smoothness with this correlation length, mm.
    GaussianMm(f64),
    /// Gaussian smoothness balanced by sensitivity.
    Balanced {
        /// Correlation length relative to half the shorter side of the skin.
        relative_length: f64,
        /// NOSER exponent of the balance.
        exponent: f64,
    },
    /// Weighted sum.
    Mixture(Vec<MixturePart>),
}

impl Default for PriorChoice {
    fn default() -> Self {
        PriorChoice::Balanced { relative_length: 0.2, exponent: 1.0 }
    }
}

/// A part of a mixture of priors.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MixturePart {
    /// Its weight.
    pub weight: f64,
    /// The prior.
    pub prior: PriorChoice,
}

/// Hyperparameter rules by name.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum HyperparameterChoice {
    /// lambda itself.
    Number(f64),
    /// lambda^2 relative to the mean eigenvalue of the data-space matrix.
    Relative(f64),
    /// Corner of the L-curve of the frames at hand.
    LCurve,
    /// Generalised cross-validation on the frames at hand.
    Gcv,
    /// Noise figure for a small touch in the middle.
    NoiseFigure(f64),
    /// Expected mean squared whitened residual of the frames at hand.
    KnownNoise(f64),
}

impl Default for HyperparameterChoice {
    fn default() -> Self {
        HyperparameterChoice::Relative(0.1)
    }
}

/// How much each channel counts.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum WeightChoice {
    /// All alike.
    Identity,
    /// Model and instrument error as a floor plus a share of the channel: standard deviation
    /// `sqrt((floor max|v|)^2 + (share v)^2)` of model voltages v.
    FloorAndShare {
        /// Relative to the largest voltage.
        floor: f64,
        /// Relative to the channel's own voltage.
        share: f64,
    },
    /// Standard deviations of the baseline frames, with the floor above.
    Measured {
        /// Relative to the largest voltage.
        floor: f64,
    },
    /// Full covariance of the baseline frames, shrunk toward its diagonal.
    MeasuredFull,
    /// Disagreement of reciprocal channels in the baseline.
    Reciprocity {
        /// Relative to the largest voltage.
        floor: f64,
    },
}

impl Default for WeightChoice {
    fn default() -> Self {
        WeightChoice::FloorAndShare { floor: 0.02, share: 0.1 }
    }
}

/// What a measured baseline is matched to the model by, before differences are imaged.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum GainMatch {
    /// One factor for the whole frame (unknown gain or conductivity).
    #[default]
    Global,
    /// One factor for the whole frame, found by regression with an intercept: the instrument adds an offset, which cancels
    /// in differences but would bend the factor.
    GlobalWithOffset,
    /// One factor a drive (drive amplitudes differ).
    Drive,
    /// One factor a channel: normalised differences, v/v0 - 1.
    Channel,
}

/// Which change of conductivity counts as positive in images.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Polarity {
    /// A touch raises conductivity.
    #[default]
    RaisesConductivity,
    /// A touch lowers conductivity.
    LowersConductivity,
}

impl Polarity {
    /// +1 or -1.
    pub fn sign(self) -> f64 {
        match self {
            Polarity::RaisesConductivity => 1.0,
            Polarity::LowersConductivity => -1.0,
        }
    }
}

/// From images to touches.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TouchSettings {
    /// Touches begin above this many standard deviations of the image noise.
    pub begin_sigma: f64,
    /// And end below this many.
    pub hold_sigma: f64,
    /// Peaks below this share of the strongest one are side lobes.
    pub side_lobe_share: f64,
    /// Smallest amplitude (relative conductivity change) that counts.
    pub smallest_amplitude: f64,
    /// Frames that a contact must last before it is a touch.
    pub least_frames: u32,
    /// Also find changes of the other sign (tanks).
    pub both_signs: bool,
    /// Channel noise assumed where none was measured, as a share of the largest voltage.
    pub assumed_noise_share: f64,
    /// Size of a touch as calibration and localisation assume it: standard deviation of a Gaussian, relative to half the
    /// shorter side of the skin.
    pub relative_size: f64,
    /// Error of positions that noise does not explain, mm.
    pub position_floor_mm: f64,
    /// Contact conductance per area of a typical touch on a sandwich, S/m^2.
    pub contact_s_per_m2: f64,
    /// Refine touches by fitting place, amplitude and radius to the forward model.
    pub refine: bool,
    /// Time constant of the drift compensation, seconds; 0 switches it off. It stands still under touch.
    pub drift_time_constant_s: f64,
}

impl Default for TouchSettings {
    fn default() -> Self {
        Self {
            begin_sigma: 5.0,
            hold_sigma: 3.0,
            side_lobe_share: 0.4,
            smallest_amplitude: 0.0,
            least_frames: 2,
            both_signs: false,
            assumed_noise_share: 1e-4,
            relative_size: 0.1,
            contact_s_per_m2: 700.0,
            position_floor_mm: 2.0,
            refine: false,
            drift_time_constant_s: 60.0,
        }
    }
}

impl Skin {
    /// A built-in skin by name, or a skin file by path.
    ///
    /// # Errors
    /// Neither exists, or the file is not a valid skin.
    pub fn open(name_or_path: &str) -> Result<Self, Error> {
        if let Some(text) = builtin_text(name_or_path) {
            return Self::parse(text, &format!("built-in skin {name_or_path}"));
        }
        let path = Path::new(name_or_path);
        match std::fs::read_to_string(path) {
            Ok(text) => Self::parse_in(&text, name_or_path, Some(path.parent().unwrap_or(Path::new("")))),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
                Err(Error::UnknownSkin { name: name_or_path.to_string(), known: BUILTIN_NAMES.join(", ") })
            }
            Err(source) => Err(Error::Io { file: path.to_path_buf(), source }),
        }
    }

    /// Parses and checks a skin file's text; `file` names it in errors. Of parts in files of their own, only built-in ones
    /// are known here: text alone lies in no folder.
    ///
    /// # Errors
    /// TOML errors, unknown or missing keys, values that make no sense; each with its place.
    pub fn parse(text: &str, file: &str) -> Result<Self, Error> {
        Self::parse_in(text, file, None)
    }

    fn parse_in(text: &str, file: &str, folder: Option<&Path>) -> Result<Self, Error> {
        let written: parts::Written = toml::from_str(text).map_err(|error| Error::SkinFile {
            file: file.to_string(),
            message: error.to_string().trim_end().to_string(),
        })?;
        let skin = written.read(file, folder)?;
        skin.check(file)?;
        Ok(skin)
    }

    /// The skin as TOML.
    pub fn to_toml(&self) -> String {
        toml::to_string_pretty(self).unwrap_or_default()
    }

    fn check(&self, file: &str) -> Result<(), Error> {
        let positive: [(&'static str, f64); 3] = [
            ("frontend.layer.thickness_mm", self.frontend.layer.thickness_mm),
            ("frontend.layer.conductivity_s_per_m", self.frontend.layer.conductivity_s_per_m),
            ("backend.current_ma", self.backend.current_ma),
        ];
        for (field, value) in positive {
            if !(value > 0.0 && value.is_finite()) {
                return Err(refused(file, field, value, "a positive number"));
            }
        }
        if let Some(Bend::Cylinder { diameter_mm }) = self.frontend.bend {
            let (low, high) = self.outline().bounds_m();
            let least = 1e3 * (high[0] - low[0]) / std::f64::consts::PI;
            if !(diameter_mm > least && diameter_mm.is_finite()) {
                let expected = format!("above {least:.1}, which the sheet would reach round");
                return Err(refused(file, "frontend.bend.cylinder.diameter_mm", diameter_mm, &expected));
            }
        }
        // Faults of electrodes are for skins that have any.
        let electrodes = match self.modality {
            Modality::Eit => self.check_electrodes(file)?,
            Modality::Mit => self.check_magnetic(file).map(|()| 0)?,
        };
        let named = self.twin.names_channels();
        let channels = if named { self.protocol().ok().map(|protocol| protocol.channel_count()) } else { None };
        let coils = if self.modality == Modality::Mit { self.electrode_shapes().len() } else { 0 };
        self.twin.check(twin::Parts { electrodes, coils, channels }, &self.frontend.layer.kind, file)?;
        self.health.check(file)?;
        self.damage.check(file)?;
        if !(4..=512).contains(&self.imaging.grid) {
            return Err(refused(file, "imaging.grid", self.imaging.grid, "4 to 512 pixels"));
        }
        if !(50..=500_000).contains(&self.imaging.elements) {
            return Err(refused(file, "imaging.elements", self.imaging.elements, "50 to 500000 elements"));
        }
        let touch = &self.touch;
        if !(touch.begin_sigma >= touch.hold_sigma && touch.hold_sigma > 0.0 && touch.begin_sigma.is_finite()) {
            let value = format!("{} with hold_sigma = {}", touch.begin_sigma, touch.hold_sigma);
            return Err(refused(file, "touch.begin_sigma", value, "begin_sigma >= hold_sigma > 0"));
        }
        for (field, value) in [
            ("touch.relative_size", touch.relative_size),
            ("touch.position_floor_mm", touch.position_floor_mm),
            ("touch.contact_s_per_m2", touch.contact_s_per_m2),
        ] {
            if !(value > 0.0 && value.is_finite()) {
                return Err(refused(file, field, value, "a positive number"));
            }
        }
        if let Some(refinement) = &self.imaging.refinement {
            refinement.check(self, file)?;
        }
        if !(touch.drift_time_constant_s >= 0.0 && touch.drift_time_constant_s.is_finite()) {
            return Err(refused(file, "touch.drift_time_constant_s", touch.drift_time_constant_s, "0 or more"));
        }
        if !(touch.assumed_noise_share > 0.0 && touch.assumed_noise_share < 1.0) {
            return Err(refused(file, "touch.assumed_noise_share", touch.assumed_noise_share, "between 0 and 1"));
        }
        Ok(())
    }

    fn check_electrodes(&self, file: &str) -> Result<usize, Error> {
        let impedance = self.frontend.contact_impedance_ohm_m2;
        if !(impedance > 0.0 && impedance.is_finite()) {
            return Err(refused(file, "frontend.contact_impedance_ohm_m2", impedance, "a positive number"));
        }
        let electrodes = match &self.frontend.electrodes {
            Electrodes::Rim { count, .. } => *count,
            Electrodes::RimPads { per_side, .. } => per_side.saturating_mul(4),
            Electrodes::PadGrid { per_side, .. } => per_side.saturating_mul(*per_side),
            Electrodes::RimList(list) => list.len(),
            Electrodes::Pads(pads) => pads.len(),
        };
        if !(2..=MOST_ELECTRODES).contains(&electrodes) {
            let expected = format!("2 to {MOST_ELECTRODES} electrodes");
            return Err(refused(file, "frontend.electrodes", electrodes, &expected));
        }
        if self.frontend.coils.is_some() || self.frontend.elements.is_some() {
            return Err(refused(file, "frontend.coils", "given", "coils and elements only with modality = \"mit\""));
        }
        if self.backend.drive == DrivePattern::EachCoil || self.backend.measure == MeasurePattern::HigherCoils {
            return Err(refused(file, "backend.drive", "coils", "a pattern of electrodes with modality = \"eit\""));
        }
        if self.imaging.solve == Solve::Heights {
            return Err(refused(file, "imaging.solve", "heights", "pixels, except with modality = \"mit\""));
        }
        Ok(electrodes)
    }
}

fn refused(file: &str, field: &'static str, value: impl ToString, expected: &str) -> Error {
    Error::SkinField { file: file.to_string(), field, value: value.to_string(), expected: expected.to_string() }
}
