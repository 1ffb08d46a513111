//! The skin file as a whole: reading, checking, writing.

use std::path::Path;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::backend::Backend;
use crate::builtin::{BUILTIN_NAMES, builtin_text};
use crate::check::Checker;
use crate::damage::DamageSettings;
use crate::error::{Error, FileError};
use crate::frontend::Frontend;
use crate::guard::GuardSettings;
use crate::health::HealthSettings;
use crate::imaging::Imaging;
use crate::layer::Layer;
use crate::parts::{Part, read_skin_text};
use crate::tolerances::Tolerances;
use crate::touch::TouchSettings;
use crate::twin::{Parts, TwinSettings};

/// A whole skin file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Skin {
    /// Short name, as used on the command line.
    pub name: String,
    /// One-line description for display.
    #[serde(default)]
    pub title: String,
    /// Physics used to read it.
    pub modality: Modality,
    /// Geometry, material, electrodes.
    pub frontend: Frontend,
    /// Instrument and protocol.
    pub backend: Backend,
    /// Settings from difference data to images.
    #[serde(default)]
    pub imaging: Imaging,
    /// Settings from images to touches.
    #[serde(default)]
    pub touch: TouchSettings,
    /// Settings for watching its channels.
    #[serde(default, skip_serializing_if = "HealthSettings::is_default")]
    pub health: HealthSettings,
    /// Settings for telling damage from touch.
    #[serde(default, skip_serializing_if = "DamageSettings::is_default")]
    pub damage: DamageSettings,
    /// Limits at which a machine should stop. `None`: no guard.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub guard: Option<GuardSettings>,
    /// Settings of its twin.
    #[serde(default, skip_serializing_if = "is_default")]
    pub twin: TwinSettings,
    /// Manufacturing tolerances.
    #[serde(default, skip_serializing_if = "Tolerances::is_default")]
    pub tolerances: Tolerances,
    /// Its position on a robot.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mount: Option<Mount>,
}

fn is_default(twin: &TwinSettings) -> bool {
    *twin == TwinSettings::default()
}

/// Physics used to read a skin.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Modality {
    /// Electrical impedance tomography.
    Eit,
    /// Magnetic induction tomography.
    Mit,
}

impl Modality {
    /// The name in skin files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Eit => "eit",
            Self::Mit => "mit",
        }
    }

    /// Quantity shown in its images.
    pub fn image_quantity(self) -> &'static str {
        match self {
            Self::Eit => "relative conductivity change",
            Self::Mit => "share of the elements' travel",
        }
    }
}

impl Skin {
    /// Opens a built-in skin by name, or a skin file by path.
    ///
    /// # Errors
    /// Fails if neither exists, or if the file is not a valid skin.
    pub fn open(name_or_path: &str) -> Result<Self, Error> {
        if let Some(text) = builtin_text(name_or_path) {
            return Self::parse(text, &format!("built-in skin {name_or_path}"));
        }
        let path = Path::new(name_or_path);
        match read_skin_text(path) {
            Ok(text) => Self::read(&text, name_or_path, Some(path.parent().unwrap_or(Path::new("")))),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
                Err(Error::UnknownSkin { name: name_or_path.to_string(), known: BUILTIN_NAMES.join(", ") })
            }
            Err(source) => Err(Error::Io(FileError { file: path.to_path_buf(), source })),
        }
    }

    /// Parses and checks the text of a skin file; `file` names it in errors. Text has no folder, so the only parts in
    /// separate files that it can use are the built-in ones.
    ///
    /// # Errors
    /// TOML errors, unknown or missing keys, invalid values; each with its place.
    pub fn parse(text: &str, file: &str) -> Result<Self, Error> {
        Self::read(text, file, None)
    }

    /// As [`Skin::parse`], for the text of a file that may or may not exist yet. Its parts may be next to it.
    ///
    /// # Errors
    /// As [`Skin::parse`].
    pub fn parse_beside(text: &str, file: &Path) -> Result<Self, Error> {
        let folder = file.parent().unwrap_or(Path::new(""));
        Self::read(text, &file.display().to_string(), Some(folder))
    }

    fn read(text: &str, file: &str, folder: Option<&Path>) -> Result<Self, Error> {
        let misread = |error: toml::de::Error| Error::SkinFile {
            file: file.to_string(),
            message: error.to_string().trim_end().to_string(),
        };
        let written: Written = toml::from_str(text).map_err(misread)?;
        let says_polarity = toml::from_str::<toml::Table>(text)
            .is_ok_and(|table| table.get("imaging").is_some_and(|imaging| imaging.get("polarity").is_some()));
        let mut skin = written.read(file, folder)?;
        if !says_polarity {
            skin.imaging.polarity = skin.frontend.layer.polarity();
        }
        if skin.touch.refine.take().is_some() {
            tracing::warn!("{file}: touch.refine is no longer needed: touches are always fitted; remove the line");
        }
        if skin.touch.contact_s_per_m2.take().is_some() {
            tracing::warn!(
                "{file}: touch.contact_s_per_m2 is no longer needed: it follows from the layer's law; remove the line"
            );
        }
        skin.check(file)?;
        Ok(skin)
    }

    /// Checks a skin made in code.
    ///
    /// # Errors
    /// As [`Skin::parse`].
    pub fn checked(self) -> Result<Self, Error> {
        self.check(&self.name)?;
        Ok(self)
    }

    /// True if the forward model can place touches on sheets, sandwiches, patches and liquids. It cannot if a readout
    /// circuit stands between model and readings. Elements above coils have their own fit.
    pub fn fits_touches(&self) -> bool {
        self.modality == Modality::Eit && self.backend.circuit.is_none()
    }

    /// True if the file states how the layer responds to a force, and presses are fitted through that law.
    pub fn states_force_law(&self) -> bool {
        let is_stated = match &self.frontend.layer {
            Layer::Sheet(layer) => layer.pressure_percent_per_kpa != 0.0 || layer.gauge_factor != 0.0,
            Layer::Liquid(layer) => layer.tension_n_per_m > 0.0,
            Layer::Sandwich(_) | Layer::Patches(_) => true,
            Layer::Elements(_) => false,
        };
        is_stated && self.fits_touches()
    }

    /// The skin as TOML.
    pub fn to_toml(&self) -> String {
        toml::to_string_pretty(self).unwrap_or_default()
    }

    fn check(&self, file: &str) -> Result<(), Error> {
        let checker = &Checker { file };
        let elements = matches!(self.frontend.layer, Layer::Elements(_));
        if elements != (self.modality == Modality::Mit) {
            let expected = "\"mit\" with layer.kind = \"elements\", \"eit\" with every other layer";
            return Err(checker.refused("modality", self.modality.name(), expected));
        }
        if self.name.is_empty() || self.name.len() > 200 || self.name.chars().any(char::is_control) {
            let expected = "a name of 1 to 200 characters without control characters";
            return Err(checker.refused("name", self.name.escape_debug(), expected));
        }
        if self.title.len() > 1000 || self.title.chars().any(char::is_control) {
            let expected = "at most 1000 characters without control characters";
            return Err(checker.refused("title", self.title.escape_debug(), expected));
        }
        self.frontend.check(checker)?;
        let (electrodes, coils) = match &self.frontend.coils {
            Some(coils) => (0, coils.count()),
            None => (self.frontend.electrodes.count(), 0),
        };
        self.backend.check(elements, electrodes, checker)?;
        // Faults may refer to channels.
        let channels = self.twin.names_channels().then(|| self.backend.protocol(electrodes.max(coils)));
        let channels = channels.and_then(Result::ok).map(|protocol| protocol.channel_count());
        self.twin.check(Parts { electrodes, coils, channels }, &self.frontend.layer, checker)?;
        self.health.check(checker)?;
        self.damage.check(checker)?;
        self.guard.as_ref().map_or(Ok(()), |guard| guard.check(&self.health, &self.backend, checker))?;
        self.tolerances.check("tolerances.", checker)?;
        self.imaging.check(elements, self.backend.circuit.is_some(), checker)?;
        self.touch.check(checker)?;
        self.mount.as_ref().map_or(Ok(()), |mount| mount.check(checker))
    }
}

/// A skin file as written; its parts may be in other files.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Written {
    name: String,
    #[serde(default)]
    title: String,
    modality: Modality,
    frontend: Part<Frontend>,
    backend: Part<Backend>,
    #[serde(default)]
    imaging: Imaging,
    #[serde(default)]
    touch: TouchSettings,
    #[serde(default)]
    health: HealthSettings,
    #[serde(default)]
    damage: DamageSettings,
    guard: Option<GuardSettings>,
    #[serde(default)]
    twin: TwinSettings,
    #[serde(default)]
    tolerances: Tolerances,
    mount: Option<Mount>,
}

impl Written {
    /// The skin with its parts read. Files are relative to `folder`; with `None`, only built-in parts are found.
    fn read(self, file: &str, folder: Option<&Path>) -> Result<Skin, Error> {
        let beside = self.backend.folder(folder);
        let mut backend = self.backend.read("backend", file, folder)?;
        backend.read_channels(file, beside.as_deref())?;
        let beside = self.frontend.folder(folder);
        let mut frontend = self.frontend.read("frontend", file, folder)?;
        frontend.read_mesh(file, beside.as_deref())?;
        Ok(Skin {
            name: self.name,
            title: self.title,
            modality: self.modality,
            frontend,
            backend,
            imaging: self.imaging,
            touch: self.touch,
            health: self.health,
            damage: self.damage,
            guard: self.guard,
            twin: self.twin,
            tolerances: self.tolerances,
            mount: self.mount,
        })
    }
}

/// Position of a skin on a robot: the frame of the skin patch relative to a link of the robot description.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Mount {
    /// Name of the link that carries the skin, as in the robot's URDF file.
    pub link: String,
    /// Origin of the skin in the link's frame, mm.
    #[serde(default)]
    pub xyz_mm: [f64; 3],
    /// Roll, pitch and yaw of the skin in the link's frame, degrees: rotations about the link's x, y and z axes, in
    /// this order.
    #[serde(default)]
    pub rpy_deg: [f64; 3],
}

impl Mount {
    pub(crate) fn check(&self, checker: &Checker<'_>) -> Result<(), Error> {
        if self.link.is_empty() || self.link.len() > 200 || self.link.chars().any(char::is_control) {
            let expected = "the name of a link, 1 to 200 characters without control characters";
            return Err(checker.refused("mount.link", self.link.escape_debug(), expected));
        }
        checker.place_mm("mount.xyz_mm", &self.xyz_mm)?;
        self.rpy_deg.iter().try_for_each(|&angle| checker.within("mount.rpy_deg", angle, -360.0, 360.0))
    }
}
