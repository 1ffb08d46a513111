//! Coils and conducting elements of a magnetic induction skin, as given in the file.

use dermis_mit::{CoilArray, CoilGrid, CoilShape, CoilSpec, Conductor, ElementShape, MitError};
use dermis_tomo::mesh::{ElectrodeShape, Outline, Point};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::check::{Checker, MM, MOST_MM};
use crate::error::Error;
use crate::pair::Pair;

/// Maximum number of elements in a skin.
const MOST_ELEMENTS: usize = 1024;
/// Maximum number of coils in a skin.
const MOST_COILS: usize = 64;
/// Minimum and maximum self inductance of a coil, microhenries. A millimetre of wire has about a thousandth of one; a
/// coil of 10,000 turns one metre wide has hundreds of henries.
const INDUCTANCE_UH: [f64; 2] = [1e-3, 1e9];

/// The coils of a skin, all identical.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Coils {
    /// Positions, which also define the numbering.
    pub places: CoilPlaces,
    /// Outline of the turns.
    pub shape: Winding,
    /// Inner width: diameter for round coils, side for square ones.
    pub inner_mm: f64,
    /// Outer width.
    pub outer_mm: f64,
    /// Total number of turns.
    pub turns: usize,
    /// Number of stacked layers; the number of turns must be a multiple of it.
    #[serde(default = "one", skip_serializing_if = "is_one")]
    pub layers: usize,
    /// Distance between neighbouring layers.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub layer_pitch_mm: f64,
    /// The conductor. Default: wire that fills 80 % of the distance between turns.
    #[serde(default, skip_serializing_if = "CoilConductor::is_default")]
    pub conductor: CoilConductor,
    /// Measured self inductance, to which the fields are scaled. Default: computed from the geometry.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub inductance_uh: Option<f64>,
    /// Height of a conducting plate underneath, such as a shield or the robot's arm; negative.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shield_mm: Option<f64>,
}

/// Positions of coils.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum CoilPlaces {
    /// On a grid around the skin's middle, row by row from the bottom left.
    Grid {
        /// Rows.
        rows: usize,
        /// Number of coils in a row.
        columns: usize,
        /// Distance between neighbours, one number or [along x, along y].
        pitch_mm: Pair<f64>,
        /// Numbers of the grid positions that stay empty, counted from 1 over all positions.
        #[serde(default, skip_serializing_if = "Vec::is_empty")]
        left_out: Vec<usize>,
    },
    /// Explicit list: [x, y, z] of each centre. Heights are counted from the plane z = 0.
    List(Vec<[f64; 3]>),
}

/// Outline of a coil's turns.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Winding {
    /// Round.
    Round,
    /// Square.
    Square,
}

/// Conductor of a coil.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum CoilConductor {
    /// Round wire whose diameter is this share of the distance between neighbouring turns.
    PitchShare(f64),
    /// Round wire.
    Wire {
        /// Wire diameter without insulation.
        diameter_mm: f64,
    },
    /// A track on a circuit board.
    Track {
        /// Width of the track.
        width_mm: f64,
        /// Thickness of the track.
        thickness_mm: f64,
    },
}

impl Default for CoilConductor {
    fn default() -> Self {
        Self::PitchShare(0.8)
    }
}

impl CoilConductor {
    fn is_default(&self) -> bool {
        *self == Self::default()
    }
}

/// Conducting elements that a touch moves towards the coils.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Elements {
    /// Positions, which also define the numbering.
    pub places: ElementPlaces,
    /// Height of their centres above the coils at rest.
    pub rest_mm: f64,
    /// Travel when fully pressed: image value 1.
    pub travel_mm: f64,
    /// Shape of each element.
    pub shape: ElementShape,
}

/// Positions of elements.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum ElementPlaces {
    /// On a grid around the skin's middle, row by row from the bottom left.
    Grid {
        /// Rows.
        rows: usize,
        /// Number of elements in a row.
        columns: usize,
        /// Distance between neighbours, one number or [along x, along y].
        pitch_mm: Pair<f64>,
    },
    /// Explicit list.
    List {
        /// Centre [x, y] of each element.
        at_mm: Vec<Point>,
        /// Width and height of the cell around each element; pressure on the cell presses the element.
        cell_mm: Pair<f64>,
    },
}

fn one() -> usize {
    1
}

fn is_one(value: &usize) -> bool {
    *value == 1
}

fn is_zero(value: &f64) -> bool {
    *value == 0.0
}

impl Coils {
    /// The specification of one coil.
    pub fn spec(&self) -> CoilSpec {
        CoilSpec {
            shape: match self.shape {
                Winding::Round => CoilShape::Round,
                Winding::Square => CoilShape::Square,
            },
            inner_m: self.inner_mm * MM,
            outer_m: self.outer_mm * MM,
            turns: self.turns,
            layers: self.layers,
            layer_pitch_m: self.layer_pitch_mm * MM,
            conductor: match self.conductor {
                CoilConductor::PitchShare(share) => Conductor::PitchShare(share),
                CoilConductor::Wire { diameter_mm } => Conductor::Wire { diameter_m: diameter_mm * MM },
                CoilConductor::Track { width_mm, thickness_mm } => {
                    Conductor::Track { width_m: width_mm * MM, thickness_m: thickness_mm * MM }
                }
            },
            inductance_h: self.inductance_uh.map(|uh| uh * 1e-6),
        }
    }

    /// Centres, metres, in order.
    ///
    /// # Errors
    /// Fails if a position to leave out does not exist.
    pub fn places_m(&self) -> Result<Vec<[f64; 3]>, MitError> {
        match &self.places {
            CoilPlaces::Grid { rows, columns, pitch_mm, left_out } => CoilGrid {
                rows: *rows,
                columns: *columns,
                pitch_m: pitch_mm.both().map(|pitch| pitch * MM),
                left_out: left_out.clone(),
            }
            .places_m(),
            CoilPlaces::List(places) => Ok(places.iter().map(|place| place.map(|value| value * MM)).collect()),
        }
    }

    /// The coil array above its shield.
    ///
    /// # Errors
    /// Fails if coils overlap each other or the shield, or if a winding does not fit.
    pub fn array(&self) -> Result<CoilArray, MitError> {
        let array = CoilArray::new(&self.spec(), &self.places_m()?)?;
        match self.shield_mm {
            Some(z_mm) => array.with_shield(z_mm * MM),
            None => Ok(array),
        }
    }

    /// Number of coils.
    pub fn count(&self) -> usize {
        match &self.places {
            CoilPlaces::Grid { rows, columns, left_out, .. } => {
                rows.saturating_mul(*columns).saturating_sub(left_out.len())
            }
            CoilPlaces::List(places) => places.len(),
        }
    }

    /// Outlines of the coils, for drawing; empty if their positions are invalid.
    pub fn outlines(&self) -> Vec<ElectrodeShape> {
        let width_m = self.outer_mm * MM;
        let outline = |place: &[f64; 3]| {
            let centre_m = [place[0], place[1]];
            match self.shape {
                Winding::Round => ElectrodeShape::PadCircle { centre_m, radius_m: 0.5 * width_m },
                Winding::Square => {
                    ElectrodeShape::PadRectangle { centre_m, width_m, height_m: width_m, angle_rad: 0.0 }
                }
            }
        };
        self.places_m().map_or(Vec::new(), |places| places.iter().map(outline).collect())
    }

    pub(crate) fn check(&self, checker: &Checker<'_>) -> Result<(), Error> {
        let key = |name: &str| format!("frontend.coils.{name}");
        checker.count(&key("places"), self.count(), 2, MOST_COILS)?;
        match &self.places {
            CoilPlaces::Grid { rows, columns, pitch_mm, .. } => {
                checker.count(&key("places.grid.rows"), *rows, 1, MOST_COILS)?;
                checker.count(&key("places.grid.columns"), *columns, 1, MOST_COILS)?;
                pitch_mm.both().iter().try_for_each(|p| checker.length_mm(&key("places.grid.pitch_mm"), *p))?;
            }
            CoilPlaces::List(places) => {
                places.iter().try_for_each(|place| checker.place_mm(&key("places.list"), place))?;
            }
        }
        checker.length_mm(&key("inner_mm"), self.inner_mm)?;
        checker.within(&key("outer_mm"), self.outer_mm, self.inner_mm * (1.0 + 1e-9), MOST_MM)?;
        checker.count(&key("turns"), self.turns, 1, 10_000)?;
        checker.count(&key("layers"), self.layers, 1, 1000)?;
        checker.within(&key("layer_pitch_mm"), self.layer_pitch_mm, 0.0, 1e3)?;
        match self.conductor {
            CoilConductor::PitchShare(share) => checker.within(&key("conductor.pitch-share"), share, 1e-3, 1.0)?,
            CoilConductor::Wire { diameter_mm } => {
                checker.length_mm(&key("conductor.wire.diameter_mm"), diameter_mm)?
            }
            CoilConductor::Track { width_mm, thickness_mm } => {
                checker.length_mm(&key("conductor.track.width_mm"), width_mm)?;
                checker.length_mm(&key("conductor.track.thickness_mm"), thickness_mm)?;
            }
        }
        self.check_room(checker)?;
        if let Some(inductance_uh) = self.inductance_uh {
            checker.within(&key("inductance_uh"), inductance_uh, INDUCTANCE_UH[0], INDUCTANCE_UH[1])?;
        }
        if let Some(z_mm) = self.shield_mm {
            checker.within(&key("shield_mm"), z_mm, -1e4, -1e-3)?;
        }
        // Checks windings, positions and the shield against each other.
        self.array().map(|_| ()).map_err(|error| checker.refused("frontend.coils", "as given", error.to_string()))
    }

    /// Checks that the conductor fits between its neighbours.
    fn check_room(&self, checker: &Checker<'_>) -> Result<(), Error> {
        let (key, width_mm) = match self.conductor {
            CoilConductor::PitchShare(_) => return Ok(()),
            CoilConductor::Wire { diameter_mm } => ("frontend.coils.conductor.wire.diameter_mm", diameter_mm),
            CoilConductor::Track { width_mm, .. } => ("frontend.coils.conductor.track.width_mm", width_mm),
        };
        let (turns, layers) = (self.turns, self.layers);
        if !turns.is_multiple_of(layers) {
            return Err(checker.refused("frontend.coils.layers", layers, format!("a divisor of turns = {turns}")));
        }
        let room_mm = self.spec().even_pitch_m() / MM;
        if width_mm <= room_mm * (1.0 + 1e-9) {
            return Ok(());
        }
        let expected = format!(
            "at most {room_mm:.3} mm, the distance of {} turns side by side between inner_mm and outer_mm",
            turns / layers
        );
        Err(checker.refused(key, width_mm, expected))
    }
}

impl Elements {
    /// Centres of the elements, metres.
    pub fn places_m(&self) -> Vec<Point> {
        match &self.places {
            ElementPlaces::Grid { rows, columns, pitch_mm } => {
                let [px, py] = pitch_mm.both();
                let at = |k: usize, of: usize, pitch: f64| (k as f64 - 0.5 * (of as f64 - 1.0)) * pitch * MM;
                (0..rows * columns).map(|k| [at(k % columns, *columns, px), at(k / columns, *rows, py)]).collect()
            }
            ElementPlaces::List { at_mm, .. } => at_mm.iter().map(|p| p.map(|value| value * MM)).collect(),
        }
    }

    /// Width and height of an element's cell, metres.
    pub fn cell_m(&self) -> [f64; 2] {
        match &self.places {
            ElementPlaces::Grid { pitch_mm, .. } => pitch_mm.both().map(|pitch| pitch * MM),
            ElementPlaces::List { cell_mm, .. } => cell_mm.both().map(|cell| cell * MM),
        }
    }

    /// The shorter side of a cell, metres.
    pub fn pitch_m(&self) -> f64 {
        let [x, y] = self.cell_m();
        x.min(y)
    }

    /// Number of elements.
    pub fn count(&self) -> usize {
        match &self.places {
            ElementPlaces::Grid { rows, columns, .. } => rows.saturating_mul(*columns),
            ElementPlaces::List { at_mm, .. } => at_mm.len(),
        }
    }

    pub(crate) fn check(&self, tolerance_mm: f64, outline: &Outline, checker: &Checker<'_>) -> Result<(), Error> {
        let key = |name: &str| format!("frontend.elements.{name}");
        checker.count(&key("places"), self.count(), 1, MOST_ELEMENTS)?;
        match &self.places {
            ElementPlaces::Grid { rows, columns, pitch_mm } => {
                checker.count(&key("places.grid.rows"), *rows, 1, MOST_ELEMENTS)?;
                checker.count(&key("places.grid.columns"), *columns, 1, MOST_ELEMENTS)?;
                pitch_mm.both().iter().try_for_each(|p| checker.length_mm(&key("places.grid.pitch_mm"), *p))?;
            }
            ElementPlaces::List { at_mm, cell_mm } => {
                at_mm.iter().try_for_each(|p| checker.place_mm(&key("places.list.at_mm"), p))?;
                cell_mm.both().iter().try_for_each(|c| checker.length_mm(&key("places.list.cell_mm"), *c))?;
            }
        }
        check_shape(&self.shape, checker)?;
        let (low, high) = outline.bounds_m();
        let off = |p: &&Point| (0..2).any(|axis| p[axis] < low[axis] || p[axis] > high[axis]);
        if let Some([x, y]) = self.places_m().iter().find(off) {
            let value = format!("[{}, {}] mm", x / MM, y / MM);
            return Err(checker.refused(&key("places"), value, "middles of elements on the skin"));
        }
        checker.within(&key("rest_mm"), self.rest_mm, 1e-2, 1e3)?;
        checker.within(&key("travel_mm"), self.travel_mm, 1e-3, 1e3)?;
        checker.within("frontend.layer.height_tolerance_mm", tolerance_mm, 0.0, 0.1 * self.pitch_m() / MM)?;
        let radius_mm = self.shape.volume_radius_m() / MM;
        if self.rest_mm - self.travel_mm < radius_mm {
            let expected =
                format!("at most {:.1}, from where elements would reach the coils", self.rest_mm - radius_mm);
            return Err(checker.refused(&key("travel_mm"), self.travel_mm, expected));
        }
        Ok(())
    }
}

fn check_shape(shape: &ElementShape, checker: &Checker<'_>) -> Result<(), Error> {
    let key = |name: &str| format!("frontend.elements.shape.{name}");
    let sizes = match *shape {
        ElementShape::Sphere { diameter_mm } => {
            [("sphere.diameter_mm", diameter_mm), ("sphere.diameter_mm", diameter_mm)]
        }
        ElementShape::Cylinder { diameter_mm, height_mm } => {
            [("cylinder.diameter_mm", diameter_mm), ("cylinder.height_mm", height_mm)]
        }
        ElementShape::Plate { side_mm, height_mm } => [("plate.side_mm", side_mm), ("plate.height_mm", height_mm)],
    };
    sizes.iter().try_for_each(|(name, value)| checker.within(&key(name), *value, 1e-2, 1e3))
}
