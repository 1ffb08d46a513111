//! Commands from the page to the pipeline, and checks that reject impossible ones.

use dermis_skin::TwinAction;
use dermis_tomo::mesh::Point;
use dermis_twin::from_skin::treatment_of;
use serde::Deserialize;
use std::collections::BTreeMap;

use crate::scene::Scene;

/// A command from the page. Lengths are millimetres in the skin's frame.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Command {
    /// Take a new baseline; refused under load unless forced.
    Tare {
        /// Take it even while something touches the skin.
        force: bool,
    },
    /// Start recording raw frames.
    RecordStart,
    /// End the recording.
    RecordStop,
    /// Use this positive hyperparameter from 0.3 s later. Of several in a row the last counts; the others are answered
    /// as replaced.
    Hyperparameter(f64),
    /// Press on the twin; up to 16 at once per page.
    Press(Press),
    /// Move a current press, or change its radius or pressure.
    Move(Press),
    /// End a press. The presses of a closed page end too.
    Release {
        /// The press to end.
        pointer_id: u64,
    },
    /// Treat the twin of a self-healing skin.
    Treat(TwinAction),
    /// Stop the twin's demonstration, or show it while nobody presses.
    Demonstrate(bool),
    /// Show these channels (0-based), at most 64.
    ChooseChannels(Vec<u32>),
}

/// A round indenter on the twin.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Press {
    /// Identifies the press: unique among all open pages, stable from press to release.
    pub pointer_id: u64,
    /// Position to the right of the skin's origin.
    pub x_mm: f64,
    /// Position above the skin's origin.
    pub y_mm: f64,
    /// Radius of the indenter.
    pub radius_mm: f64,
    /// Pressure under it, kilopascals.
    pub pressure_kpa: f64,
}

impl Command {
    /// Maximum number of channels that can be displayed at once.
    pub const MOST_CHANNELS: usize = 64;
    /// Maximum number of presses that one page can hold at once.
    pub const MOST_PRESSES: usize = 16;

    /// Rejects impossible commands: presses on a real skin, values outside the scene's limits.
    ///
    /// # Errors
    /// A sentence for the page that states what was rejected and what was expected.
    pub fn check(&self, scene: &Scene) -> Result<(), String> {
        match self {
            Self::Tare { .. } | Self::RecordStart | Self::RecordStop => Ok(()),
            Self::Hyperparameter(value) if value.is_finite() && *value > 0.0 => Ok(()),
            Self::Hyperparameter(value) => {
                Err(format!("hyperparameter {value} refused: expected a positive finite number"))
            }
            Self::Press(press) => press.check(scene).and_then(|()| press.check_on_skin(scene)),
            Self::Move(press) => press.check(scene),
            Self::Release { .. } if scene.is_twin => Ok(()),
            Self::Release { .. } => Err("release refused: this skin is real".into()),
            Self::Demonstrate(_) if scene.is_twin => Ok(()),
            Self::Demonstrate(_) => Err("demonstration refused: this skin is real".into()),
            Self::Treat(_) if !scene.is_treatable => {
                Err("treatment refused: only the twin of a self-healing skin is cut and healed here".into())
            }
            Self::Treat(action) => treatment_of(*action).check().map_err(|error| format!("treatment refused: {error}")),
            Self::ChooseChannels(indices) => check_channels(indices, scene),
        }
    }
}

impl Press {
    /// Position, metres.
    pub fn position_m(&self) -> Point {
        [self.x_mm * 1e-3, self.y_mm * 1e-3]
    }

    /// Radius of the indenter, metres.
    pub fn radius_m(&self) -> f64 {
        self.radius_mm * 1e-3
    }

    /// Pressure under it, pascals.
    pub fn pressure_pa(&self) -> f64 {
        self.pressure_kpa * 1e3
    }

    /// Rejects a press that begins off the skin. A press that slides off may come back.
    fn check_on_skin(&self, scene: &Scene) -> Result<(), String> {
        let (x, y) = (self.x_mm, self.y_mm);
        // Count crossings of a ray to the right with all rings: odd means inside, with holes taken into account.
        let crosses =
            |[ax, ay]: [f64; 2], [bx, by]: [f64; 2]| (ay > y) != (by > y) && x < ax + (y - ay) / (by - ay) * (bx - ax);
        let rings = scene.outline_mm.iter();
        let crossings = rings.flat_map(|ring| (0..ring.len()).map(move |k| (ring[k], ring[(k + 1) % ring.len()])));
        if scene.outline_mm.is_empty() || crossings.filter(|(a, b)| crosses(*a, *b)).count() % 2 == 1 {
            return Ok(());
        }
        Err(format!("press refused: ({x:.1}, {y:.1}) mm is off the skin"))
    }

    fn check(&self, scene: &Scene) -> Result<(), String> {
        if !scene.is_twin {
            return Err("press refused: this skin is real, press it by hand".into());
        }
        let grid = &scene.grid;
        let limits = &scene.press;
        // Allow a margin around the image, so that a press that slides off the skin is followed until it is released.
        let (margin_x, margin_y) = ((grid.x_max_mm - grid.x_min_mm) / 2.0, (grid.y_max_mm - grid.y_min_mm) / 2.0);
        let checks = [
            ("x_mm", self.x_mm, grid.x_min_mm - margin_x, grid.x_max_mm + margin_x),
            ("y_mm", self.y_mm, grid.y_min_mm - margin_y, grid.y_max_mm + margin_y),
            ("radius_mm", self.radius_mm, limits.radius_mm[0], limits.radius_mm[1]),
            ("pressure_kpa", self.pressure_kpa, limits.pressure_kpa[0], limits.pressure_kpa[1]),
        ];
        for (field, value, least, most) in checks {
            if !(least..=most).contains(&value) {
                return Err(format!("press refused: {field} is {value}, expected {least} to {most}"));
            }
        }
        Ok(())
    }
}

fn check_channels(indices: &[u32], scene: &Scene) -> Result<(), String> {
    let count = scene.channel_labels.len();
    if indices.len() > Command::MOST_CHANNELS {
        return Err(format!("{} channels refused: expected at most {}", indices.len(), Command::MOST_CHANNELS));
    }
    match indices.iter().find(|&&index| index as usize >= count) {
        Some(index) => Err(format!("channel {index} refused: expected an index below {count}")),
        None => Ok(()),
    }
}

/// A command from the page of a body.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum BodyCommand {
    /// A command to one patch.
    Patch(PatchCommand),
    /// Values of joints, radians or metres.
    Joints(BTreeMap<String, f64>),
}

/// A command to one patch.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PatchCommand {
    /// Number of the patch in the scene.
    pub number: usize,
    /// The command, as from the patch's own page.
    pub command: Command,
}
