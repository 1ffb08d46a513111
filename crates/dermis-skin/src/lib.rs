//! Description of a tactile skin: its file, validated, and its geometry as meshes. Nothing is solved here.
//!
//! A skin file is TOML with a unit in every key. It describes the part on the robot ([`Frontend`]), the instrument
//! ([`Backend`]), and how images and touches are computed. Unknown keys and numbers out of range are errors that show
//! their place.
//!
//! ```
//! use dermis_skin::{Layer, SheetLayer, Skin};
//!
//! // A built-in skin, a path, or text.
//! let skin = Skin::open("healing-square")?;
//! assert_eq!(skin.protocol()?.channel_count(), 208);
//! // The same in code as in TOML: the file is what it prints.
//! let layer = Layer::Sheet(SheetLayer::gel(5.0, 0.2));
//! let gel = Skin::rectangle("gel-pad", 150.0, 60.0, layer).with_rim_electrodes(20, 5.0);
//! assert_eq!(Skin::parse(&gel.to_toml(), "gel-pad.toml")?, gel);
//! # Ok::<(), dermis_skin::Error>(())
//! ```

mod backend;
pub mod budget;
mod builder;
mod builtin;
mod channel_list;
mod check;
mod choice;
mod damage;
mod electronics;
mod error;
mod frontend;
mod geometry;
mod guard;
mod health;
mod imaging;
mod layer;
mod magnetic;
mod mesh_file;
mod mesh_source;
mod pair;
mod parts;
mod refinement;
mod schema;
mod skin;
mod tolerances;
mod touch;
mod twin;

pub use backend::{
    Backend, Circuit, CircuitChoice, DrivePattern, DrivenChannels, LearnCircuit, MeasurePattern, ReadingOrder, Reads,
    ReferenceChoice, Wiring,
};
pub use builtin::{BUILTIN_NAMES, DEFAULT_NAME, builtin_text};
pub use channel_list::{AgainstWord, ChannelList, ListedChannel};
pub use damage::DamageSettings;
pub use dermis_mit::{Element, ElementShape};
pub use electronics::{Electronics, ElectronicsNumbers, MultiplexerNumbers, Preset};
pub use error::{Error, FileError};
pub use frontend::{Bend, Electrodes, Frontend, Pad, PadRing, RimElectrode, Shape};
pub use geometry::SkinBody;
pub use guard::GuardSettings;
pub use health::HealthSettings;
pub use imaging::{GainMatch, HyperparameterChoice, Imaging, MixturePart, Polarity, PriorChoice, Solve, WeightChoice};
pub use layer::{ContactLaw, ElementsLayer, Layer, LiquidLayer, Memory, PatchesLayer, SandwichLayer, SheetLayer};
pub use magnetic::{CoilConductor, CoilPlaces, Coils, ElementPlaces, Elements, Winding};
pub use mesh_source::{LengthUnit, MeshFile};
pub use pair::Pair;
pub use refinement::Refinement;
pub use schema::json_schema;
pub use skin::{Modality, Mount, Skin};
pub use tolerances::{Dice, Tolerances, built_electrodes};
pub use touch::TouchSettings;
pub use twin::{
    Demonstration, Healing, NoisyChannel, PressSettings, StuckChannel, TwinAction, TwinFaults, TwinSettings,
    TwinTreatment,
};
