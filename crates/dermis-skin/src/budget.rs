//! Cost of a skin before anything is built: bytes and operations estimated from the sizes in its file, the largest
//! contribution, and the key to change. The estimates lean high: for the startup of `dermis run` they are 0.9 to 2
//! times the actual need (measured on all built-in skins and on some with grids of 16 to 160).

use std::fmt;
use std::sync::atomic::{AtomicU64, Ordering};

use dermis_mit::catalogue::needs_solving;
use dermis_mit::edge::TETRAHEDRON_BYTES;
use dermis_mit::skin_depth_m;

use crate::backend::{DrivePattern, MeasurePattern};
use crate::error::Error;
use crate::imaging::{Imaging, PriorChoice, Solve};
use crate::layer::Layer;
use crate::skin::{Modality, Skin};

/// Memory limit when neither the user nor the system sets one: 8 GB.
const MEMORY_BYTES: f64 = 8e9;
/// Longest preparation allowed without the user's consent, seconds.
const MOST_SECONDS: f64 = 1800.0;
/// Operations per second that any current machine manages: dense products on one core.
const OPERATIONS_PER_S: f64 = 4e9;
/// Memory used by the program itself, bytes.
const PROGRAM: f64 = 24e6;
/// Number of Jacobians in memory at once: the Jacobian itself, weighted and merged, with the prior applied, the
/// operator and its inputs, and the responses used to fit touches.
const JACOBIANS: f64 = 8.0;
/// Number of square matrices over the inverse problem's unknowns in memory at once.
const SYSTEMS: f64 = 3.0;
/// Number of pixels x pixels matrices needed to fit spots: the interactions and the workspace to compute them.
const INTERACTIONS: f64 = 2.2;
/// Copies in memory at once of the fields of every electrode on every node, for the image model and the touch model.
const FIELDS: f64 = 8.0;
/// Bytes of a double-precision number.
const NUMBER: f64 = 8.0;
/// Number of matrices of examples x examples, or landmarks x landmarks, in memory at once during a calibration fit.
const CORRELATIONS: f64 = 12.0;
/// Number of matrices of landmarks x examples, in single precision.
const TO_LANDMARKS: f64 = 1.5;
/// Copies of the poke frames, in double precision.
const POKE_FRAMES: f64 = 4.0;
/// Bytes per triangle, including its share of the nodes: mesh, matrix and factor.
const TRIANGLE: f64 = 600.0;
/// Extra triangles that each electrode adds to those of the sheet.
const ELECTRODE_TRIANGLES: f64 = 250.0;
/// Bytes per tetrahedron of an element's mesh to factor its system.
const BODY_FACTOR: f64 = 6000.0;
/// Operations per tetrahedron of an element's mesh to factor and solve its system.
const BODY_OPERATIONS: f64 = 1e7;
/// Operations to place a triangle, per electrode and outline vertex that affects its size.
const MESHING: f64 = 400.0;

/// Memory limit set by the user, bytes; 0 if unset.
static MEMORY: AtomicU64 = AtomicU64::new(0);

/// Limits preparations to `bytes` of memory and lifts the limit on their time.
pub fn set_memory_limit(bytes: u64) {
    MEMORY.store(bytes.max(1), Ordering::Relaxed);
    dermis_tomo::memory::set_limit(bytes);
}

/// Memory that a preparation may use, bytes: the value given to [`set_memory_limit`], or three quarters of the
/// smallest of the machine's memory, the container's limit and the address space limit. Solvers get the same limit.
pub fn memory_limit() -> u64 {
    let limit = match MEMORY.load(Ordering::Relaxed) {
        0 => (machine_bytes().map_or(MEMORY_BYTES, |bytes| 0.75 * bytes)) as u64,
        said => said,
    };
    dermis_tomo::memory::set_limit(limit);
    limit
}

fn machine_bytes() -> Option<f64> {
    let read = |path: &str| std::fs::read_to_string(path).ok();
    let machine = || {
        let text = read("/proc/meminfo")?;
        let line = text.lines().find_map(|line| line.strip_prefix("MemTotal:"))?;
        let kilobytes: f64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
        Some(kilobytes * 1024.0)
    };
    // Reads "max" if there is no limit.
    let container = || read("/sys/fs/cgroup/memory.max")?.trim().parse().ok();
    let process = || {
        let text = read("/proc/self/limits")?;
        text.lines().find_map(|line| line.strip_prefix("Max address space"))?.split_whitespace().next()?.parse().ok()
    };
    [machine(), container(), process()].into_iter().flatten().reduce(f64::min)
}

/// Cost of a preparation.
#[derive(Clone, Debug, PartialEq)]
pub struct Budget {
    /// Peak memory, bytes.
    pub bytes: f64,
    /// Seconds of work on one core.
    pub seconds: f64,
    /// The largest contribution, for display.
    pub driver: String,
    /// The key to change, with its value and the remedy.
    pub change: String,
}

impl fmt::Display for Budget {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { bytes, seconds, driver, .. } = self;
        write!(out, "about {} of memory and {}, most of it for {driver}", size(*bytes), time(*seconds))
    }
}

/// One contribution to the cost.
struct Cost {
    bytes: f64,
    operations: f64,
    driver: String,
    change: String,
}

/// The sizes that determine all costs.
struct Sizes {
    pixels: f64,
    channels: f64,
    drives: f64,
    electrodes: f64,
    vertices: f64,
}

impl Sizes {
    fn of(skin: &Skin) -> Self {
        let (low, high) = skin.outline().bounds_m();
        let (width, height) = (high[0] - low[0], high[1] - low[1]);
        let share = (skin.outline().area_m2() / (width * height)).clamp(0.0, 1.0);
        let grid = skin.imaging.grid as f64;
        // Pixels are square; the grid size counts those along the longer side.
        let pixels = grid * grid * (width.min(height) / width.max(height)) * share;
        let electrodes = skin.frontend.coils.as_ref().map_or(skin.frontend.electrodes.count(), |coils| coils.count());
        let electrodes = electrodes as f64;
        let drives = match &skin.backend.drive {
            DrivePattern::Pairs(pairs) => pairs.len() as f64,
            DrivePattern::EachCoil => 0.5 * electrodes,
            _ => electrodes,
        };
        let readings = match &skin.backend.measure {
            MeasurePattern::Pairs(pairs) => pairs.len() as f64,
            _ => electrodes,
        };
        let vertices = match &skin.frontend.shape {
            crate::Shape::Polygon { outer_mm, holes_mm } => {
                outer_mm.len() + holes_mm.iter().map(Vec::len).sum::<usize>()
            }
            _ => 4,
        };
        let channels = skin.backend.channels.as_ref().map_or(drives * readings, |list| list.channels().len() as f64);
        Self { pixels, channels, drives, electrodes, vertices: vertices as f64 }
    }
}

/// Smooth priors of a flat skin are stored as correlations along x and along y. Mixtures, and priors over pixels bent
/// out of the plane, need correlations between all pixels.
fn is_dense(prior: &PriorChoice, is_flat: bool) -> bool {
    match prior {
        PriorChoice::GaussianMm(_) | PriorChoice::Balanced { .. } => !is_flat,
        PriorChoice::Identity | PriorChoice::Laplace | PriorChoice::Noser(_) => false,
        PriorChoice::Mixture(parts) => parts.iter().any(|part| is_dense(&part.prior, false)),
    }
}

/// True if touches are fitted through a membrane, which couples every pixel to every other.
fn fits_through_membrane(skin: &Skin) -> bool {
    let has_membrane = matches!(&skin.frontend.layer, Layer::Liquid(layer) if layer.tension_n_per_m > 0.0);
    skin.fits_touches() && has_membrane
}

impl Budget {
    /// Cost of imaging a skin: its mesh, its forward model and its operator.
    pub fn of_imaging(skin: &Skin) -> Self {
        let Sizes { pixels, channels, drives, electrodes, vertices } = Sizes::of(skin);
        let Imaging { grid, elements, prior, solve, .. } = &skin.imaging;
        let triangles = *elements as f64 + ELECTRODE_TRIANGLES * electrodes;
        let mut costs = vec![mesh_cost(triangles, electrodes, vertices, format!("imaging.elements = {elements}"))];
        if skin.modality == Modality::Eit {
            costs.push(fields_cost(triangles, electrodes.max(drives), electrodes));
        }
        costs.extend(body_cost(skin));
        costs.push(Cost {
            bytes: JACOBIANS * NUMBER * channels * pixels,
            operations: 2.0 * channels * pixels * 30.0,
            driver: format!("a Jacobian and an operator of {channels:.0} channels x {pixels:.0} pixels"),
            change: match channels > pixels {
                true => format!("{electrodes:.0} electrodes or coils: use fewer, or another backend.drive or measure"),
                false => format!("imaging.grid = {grid}: use a smaller one"),
            },
        });
        if *solve == Solve::Pixels {
            let rows = channels.min(pixels);
            let change = format!("imaging.grid = {grid}");
            costs.push(Cost {
                bytes: SYSTEMS * NUMBER * rows * rows,
                operations: 2.0 * channels * pixels * rows,
                driver: format!("the inverse problem of {rows:.0} unknowns"),
                change: format!("{change}, or fewer channels"),
            });
            if fits_through_membrane(skin) {
                costs.push(Cost {
                    // Interactions of pixels, computed from the field of every pixel on every node.
                    bytes: NUMBER * pixels * (INTERACTIONS * pixels + nodes_of(triangles, electrodes)),
                    operations: pixels * pixels * (2.0 * channels.min(pixels) + 30.0),
                    driver: format!(
                        "the interactions of {pixels:.0} x {pixels:.0} pixels that touches are fitted with"
                    ),
                    change: format!("{change}: use a smaller one"),
                });
            }
            if is_dense(prior, skin.frontend.bend.is_none()) {
                costs.push(Cost {
                    bytes: NUMBER * pixels * pixels,
                    operations: pixels * pixels * (2.0 * channels.min(pixels) + 30.0),
                    driver: format!("a dense prior of {pixels:.0} x {pixels:.0} pixels"),
                    change: format!(
                        "{change}: use a smaller one, or imaging.prior = \"laplace\", \"identity\" or noser"
                    ),
                });
            }
        }
        Self::sum(PROGRAM, costs)
    }

    /// Cost of a twin with `triangles` triangles away from its electrodes.
    pub fn of_twin(skin: &Skin, triangles: f64) -> Self {
        let Sizes { electrodes, drives, vertices, .. } = Sizes::of(skin);
        let near = if skin.modality == Modality::Mit { 0.0 } else { ELECTRODE_TRIANGLES * electrodes };
        let triangles = triangles + near;
        let mut costs = vec![mesh_cost(triangles, electrodes, vertices, "twin.element_mm, left out or set".to_owned())];
        if skin.modality == Modality::Eit {
            costs.push(fields_cost(triangles, electrodes.max(drives), electrodes));
        }
        costs.extend(body_cost(skin));
        Self::sum(0.0, costs)
    }

    /// Cost of fitting a calibration to `pokes` pokes with at most `landmarks` landmarks, on top of the cost of
    /// imaging: 1 to 1.5 times the need measured with 1,500 to 12,000 pokes of 192 channels.
    pub fn of_pokes(skin: &Skin, pokes: usize, landmarks: usize) -> Self {
        let Sizes { channels, .. } = Sizes::of(skin);
        let (all, judged) = (pokes as f64, pokes.min(landmarks) as f64);
        let beyond = if all > judged { TO_LANDMARKS * 0.5 * NUMBER * all * judged } else { 0.0 };
        let fit = Cost {
            bytes: CORRELATIONS * NUMBER * judged * judged + beyond,
            operations: 2.0 * all * judged * judged,
            driver: format!("the correlations of {pokes} pokes"),
            change: format!("{pokes} pokes: use fewer, such as every second one"),
        };
        let frames = Cost {
            bytes: POKE_FRAMES * NUMBER * all * channels,
            operations: all * channels * channels,
            driver: format!("{pokes} frames of {channels:.0} channels"),
            change: format!("{pokes} pokes: use fewer, such as every second one"),
        };
        Self::sum(0.0, vec![fit, frames])
    }

    fn sum(always: f64, costs: Vec<Cost>) -> Self {
        let bytes = always + costs.iter().map(|cost| cost.bytes).sum::<f64>();
        let operations: f64 = costs.iter().map(|cost| cost.operations).sum();
        let weight = |cost: &Cost| (cost.bytes / MEMORY_BYTES).max(cost.operations / OPERATIONS_PER_S / MOST_SECONDS);
        let worst = costs.into_iter().max_by(|a, b| weight(a).total_cmp(&weight(b)));
        let (driver, change) = worst.map_or_else(Default::default, |cost| (cost.driver, cost.change));
        Self { bytes, seconds: operations / OPERATIONS_PER_S, driver, change }
    }

    /// Refuses a preparation that exceeds the limits.
    ///
    /// # Errors
    /// [`Error::Budget`] with the largest contribution and the key to change.
    pub fn check(&self, skin: &Skin, what: &'static str) -> Result<(), Error> {
        let limit = memory_limit() as f64;
        let is_said = MEMORY.load(Ordering::Relaxed) != 0;
        if self.bytes <= limit && (is_said || self.seconds <= MOST_SECONDS) {
            return Ok(());
        }
        let time = if is_said { String::new() } else { format!(" and {}", time(MOST_SECONDS)) };
        Err(Error::Budget {
            skin: skin.name.clone(),
            what,
            needed: self.to_string(),
            change: self.change.clone(),
            limit: format!("{}{time}", size(limit)),
            memory: format!("{:.0}GB", (1.1 * self.bytes.max(limit) / 1e9).ceil()),
        })
    }
}

fn mesh_cost(triangles: f64, electrodes: f64, vertices: f64, change: String) -> Cost {
    let electrodes_drive = ELECTRODE_TRIANGLES * electrodes > 0.5 * triangles;
    Cost {
        bytes: TRIANGLE * triangles,
        operations: MESHING * triangles * (electrodes + vertices),
        driver: format!("a mesh of {triangles:.0} triangles about {electrodes:.0} electrodes, {vertices:.0} vertices"),
        change: if electrodes_drive {
            format!("{electrodes:.0} electrodes in frontend.electrodes: use fewer")
        } else if vertices > 200.0 {
            format!("{vertices:.0} vertices in frontend.shape: use fewer")
        } else {
            format!("{change}: use fewer or larger elements")
        },
    }
}

/// Eddy currents in an element that has not been solved before, by edge elements.
fn body_cost(skin: &Skin) -> Option<Cost> {
    let (element, frequency_hz) = (skin.element()?, 1e3 * skin.backend.frequency_khz?);
    if !needs_solving(&element, frequency_hz) {
        return None;
    }
    let depth_m = skin_depth_m(element.conductivity_s_per_m, element.relative_permeability, frequency_hz).ok()?;
    let solid = element.shape.solid();
    let tetrahedra = solid.tetrahedron_count(&solid.grading(depth_m));
    Some(Cost {
        bytes: (TETRAHEDRON_BYTES + BODY_FACTOR) * tetrahedra,
        operations: BODY_OPERATIONS * tetrahedra,
        driver: format!("eddy currents in an element of {tetrahedra:.0} tetrahedra"),
        change: "frontend.elements.shape: make its dimensions more equal".to_owned(),
    })
}

fn nodes_of(triangles: f64, electrodes: f64) -> f64 {
    0.5 * triangles + electrodes
}

/// Fields of every electrode on every node, plus the factor.
fn fields_cost(triangles: f64, fields: f64, electrodes: f64) -> Cost {
    let nodes = nodes_of(triangles, electrodes);
    Cost {
        bytes: FIELDS * NUMBER * nodes * fields,
        // Substitution in a factor of about 30 numbers per node and right-hand side, plus the factorisation.
        operations: 120.0 * nodes * fields + 20.0 * nodes.powf(1.5),
        driver: format!("the fields of {fields:.0} electrodes or drives on {nodes:.0} nodes"),
        change: format!("{electrodes:.0} electrodes in frontend.electrodes, or imaging.elements: use fewer"),
    }
}

/// Formats bytes for display.
fn size(bytes: f64) -> String {
    match bytes {
        b if b >= 1e12 => format!("{:.1} TB", b / 1e12),
        b if b >= 1e9 => format!("{:.1} GB", b / 1e9),
        b => format!("{:.0} MB", (b / 1e6).max(1.0)),
    }
}

/// Formats seconds for display.
fn time(seconds: f64) -> String {
    match seconds {
        s if s >= 7200.0 => format!("{:.0} h", s / 3600.0),
        s if s >= 120.0 => format!("{:.0} min", s / 60.0),
        s => format!("{:.0} s", s.max(1.0)),
    }
}

/// Parses a size as users write it: `8GB`, `512MB`, `2.5G`, or a plain number of bytes.
///
/// # Errors
/// Says what was expected.
///
/// ```
/// use dermis_skin::budget::parse_bytes;
///
/// assert_eq!(parse_bytes("2.5GB"), Ok(2_500_000_000));
/// assert_eq!(parse_bytes("512M"), Ok(512_000_000));
/// assert!(parse_bytes("-1GB").is_err() && parse_bytes("much").is_err());
/// ```
pub fn parse_bytes(text: &str) -> Result<u64, String> {
    let expected = || format!("'{text}': expected a size such as 8GB, 512MB or a number of bytes, 1 MB to 1000 TB");
    let lower = text.trim().to_ascii_lowercase();
    let number = lower.trim_end_matches("ib").trim_end_matches('b');
    let (number, factor) = match number.char_indices().last() {
        Some((at, 'k')) => (&number[..at], 1e3),
        Some((at, 'm')) => (&number[..at], 1e6),
        Some((at, 'g')) => (&number[..at], 1e9),
        Some((at, 't')) => (&number[..at], 1e12),
        _ => (number, 1.0),
    };
    let bytes = number.trim().parse::<f64>().map_err(|_| expected())? * factor;
    if (1e6..=1e15).contains(&bytes) { Ok(bytes as u64) } else { Err(expected()) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::BUILTIN_NAMES;

    fn changed(name: &str, from: &str, to: &str) -> Skin {
        let text = crate::builtin_text(name).unwrap();
        assert!(text.contains(from), "{name} has no {from}");
        Skin::parse(&text.replace(from, to), "changed").unwrap()
    }

    /// True if a budget is refused on any machine.
    fn refusal(budget: &Budget) -> bool {
        budget.bytes > 24e9 || budget.seconds > MOST_SECONDS
    }

    #[test]
    fn built_in_skins_fit_and_say_what_they_cost() {
        for name in BUILTIN_NAMES {
            let skin = Skin::open(name).unwrap();
            let budget = Budget::of_imaging(&skin);
            assert!(budget.bytes < 2e9 && budget.seconds < 300.0, "{name}: {budget}");
            assert!(Budget::of_twin(&skin, 10_000.0).bytes < 2e9, "{name}");
        }
    }

    #[test]
    fn a_grid_of_512_is_refused_with_the_key_to_change() {
        let mut skin = Skin::open("ionic-square").unwrap();
        skin.imaging.grid = 512;
        let budget = Budget::of_imaging(&skin);
        // 262,144 pixels squared, at eight bytes each.
        assert!(budget.bytes > 5e11, "{budget}");
        assert!(refusal(&budget) && budget.change.contains("imaging.grid = 512"), "{budget:?}");
        assert!(budget.driver.contains("interactions"), "{budget:?}");
        let error = budget.check(&skin, "the image").unwrap_err().to_string();
        assert!(error.contains("--memory") && error.contains("imaging.grid = 512"), "{error}");
        // Without a membrane only the operator counts: smooth priors of a flat skin are small.
        let mut gel = Skin::open("healing-square").unwrap();
        gel.imaging.grid = 512;
        assert!(Budget::of_imaging(&gel).bytes < 0.02 * budget.bytes);
    }

    #[test]
    fn pokes_are_paid_for_by_their_landmarks() {
        let skin = Skin::open("ionic-disc").unwrap();
        let [exact, many] = [3000, 12_000].map(|pokes| Budget::of_pokes(&skin, pokes, 3000));
        // Measured: 680 and 940 MB, on top of 150 MB for the skin itself.
        assert!((680e6..1100e6).contains(&exact.bytes), "{exact}");
        assert!((940e6..1500e6).contains(&many.bytes) && many.seconds < 120.0, "{many}");
        let endless = Budget::of_pokes(&skin, 1_000_000_000, 3000);
        assert!(refusal(&endless) && endless.change.contains("1000000000 pokes"), "{endless:?}");
    }

    #[test]
    fn nine_hundred_pads_are_estimated_to_need_more_than_a_laptop() {
        let skin = changed("piezo-disc", "per_side = 8", "per_side = 30");
        let budget = Budget::of_imaging(&skin);
        // Refusal depends on the machine.
        assert!(budget.bytes > 10e9 && budget.seconds > 60.0, "{budget:?}");
        assert!(budget.change.contains("900 electrodes"), "{budget:?}");
    }
}
