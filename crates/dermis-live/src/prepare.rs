//! Turns a skin file into its forward model on the image grid, once per skin, before any frame arrives.

use std::ops::Range;
use std::sync::{Arc, OnceLock};

use dermis_tomo::eit::{ForwardModel, Jacobian, OrderReport, Protocol, Solution, diagnose_order};
use dermis_tomo::inner_product;
use dermis_tomo::inverse::{ImageBasis, LinearProblem, Prior};
use dermis_tomo::mesh::{ElectrodedMesh, PixelGrid, PixelMap, Point, distance};
use dermis_touch::{GridGeometry, ImageCells};

use crate::Error;
use crate::as_built::Build;
use crate::magnetic_model::MagneticModel;
use crate::stages::workshop_error::WorkshopError;
use dermis_skin::budget::Budget;
use dermis_skin::{CircuitChoice, Imaging, MixturePart, Modality, PriorChoice, Reads, Skin, SkinBody};

/// Minimum share of a pixel that the skin must cover; pixels below it are ignored.
const LEAST_RIM_COVERAGE: f64 = 5e-3;

/// Announce preparations that take longer than this, seconds.
const LONG_S: f64 = 60.0;
/// Minimum distance of two positions that may both explain a frame, in halves of the shorter side.
const PLACES_APART: f64 = 0.3;

/// A skin's forward model at rest, on the grid of its images. Its parts belong together: if one is changed, imagers
/// made before and after may not match it.
#[derive(Debug)]
pub struct Prepared {
    /// The skin file.
    pub skin: Skin,
    /// Outline, electrodes, mesh.
    pub body: SkinBody,
    /// Stimulation and measurement.
    pub protocol: Protocol,
    /// Mesh to pixels.
    pub map: PixelMap,
    /// Voltages of the resting skin, volts, signed.
    pub voltages: Vec<f64>,
    /// Channels x inside pixels: volts per relative change of conductivity, or for magnetic induction, volts per
    /// share of the elements' full travel.
    pub jacobian: Jacobian,
    /// The inside pixels as unknowns.
    pub basis: ImageBasis,
    /// The inverse problem, if it does not depend on measurements. A dense prior is the largest object in memory, and
    /// imagers that differ only in lambda share it.
    problem: OnceLock<Arc<LinearProblem>>,
    /// Errors of touches on skins as built, once they are asked for.
    workshop_error: OnceLock<Option<Arc<WorkshopError>>>,
    /// Change of the voltages on a coarser mesh, once it is asked for.
    change_by_mesh: OnceLock<f64>,
    /// How the skin was built, if that is known: then mesh, voltages and Jacobian are those of the skin as built.
    built: Option<Arc<Build>>,
}

impl Prepared {
    /// Meshes the skin and solves it at rest, if that is possible within the memory budget.
    ///
    /// # Errors
    /// Invalid shapes, electrodes or patterns; see [`Error`].
    pub fn new(skin: Skin) -> Result<Self, Error> {
        let budget = Budget::of_imaging(&skin);
        budget.check(&skin, "its image")?;
        if budget.seconds > LONG_S {
            tracing::warn!("{}: its image takes {budget}; {}", skin.name, budget.change);
        }
        let body = skin.body()?;
        let protocol = skin.protocol()?;
        let mesh_error = |source| Error::Mesh { skin: skin.name.clone(), source };
        let map = PixelMap::new(skin.grid()?, &body.mesh.mesh).map_err(mesh_error)?;
        let (voltages, jacobian) = match skin.modality {
            Modality::Mit => MagneticModel::of(&skin)?.linearised(&map.inside_centres_m(), map.grid().pixel_m)?,
            Modality::Eit => electric_model(&skin, &body, &protocol, &map, None)?,
        };
        let basis = pixel_basis(&map);
        Ok(Self {
            skin,
            body,
            protocol,
            map,
            voltages,
            jacobian,
            basis,
            problem: OnceLock::new(),
            workshop_error: OnceLock::new(),
            change_by_mesh: OnceLock::new(),
            built: None,
        })
    }

    /// The model of the skin as it was built.
    ///
    /// # Errors
    /// Manufacturing errors that cannot be built, or a skin that cannot be solved.
    pub fn as_built(&self, build: Build) -> Result<Self, Error> {
        let mesh_error = |source| Error::Mesh { skin: self.skin.name.clone(), source };
        let mesh = build.moved(&self.body).map_err(mesh_error)?;
        // A rim pixel may fall in or out when nodes move; then the pixels stay as they were.
        let map = PixelMap::new(*self.map.grid(), &mesh.mesh).map_err(mesh_error)?;
        let map = if map.inside_pixels() == self.map.inside_pixels() { map } else { self.map.clone() };
        let body = SkinBody { mesh, ..self.body.clone() };
        let (voltages, jacobian) = electric_model(&self.skin, &body, &self.protocol, &map, Some(&build))?;
        Ok(Self {
            skin: self.skin.clone(),
            body,
            protocol: self.protocol.clone(),
            map,
            voltages,
            jacobian,
            basis: self.basis.clone(),
            problem: OnceLock::new(),
            workshop_error: OnceLock::new(),
            change_by_mesh: OnceLock::new(),
            built: Some(Arc::new(build)),
        })
    }

    /// The same skin, on the same grid, with about this number of elements.
    ///
    /// # Errors
    /// As [`Prepared::new`] and [`Prepared::as_built`].
    pub(crate) fn with_elements(&self, elements: usize) -> Result<Self, Error> {
        let imaging = Imaging { elements, ..self.skin.imaging.clone() };
        let drawn = Self::new(Skin { imaging, ..self.skin.clone() })?;
        match &self.built {
            None => Ok(drawn),
            Some(build) => drawn.as_built((**build).clone()),
        }
    }

    /// Sets the errors of touches that remain on the skin as built.
    #[must_use]
    pub(crate) fn with_errors(self, errors: Arc<WorkshopError>) -> Self {
        Self { workshop_error: OnceLock::from(Some(errors)), ..self }
    }

    /// True if mesh, voltages and Jacobian are those of the skin as built.
    pub fn is_as_built(&self) -> bool {
        self.built.is_some()
    }

    /// Sheet conductance of every element at rest, siemens.
    pub(crate) fn conductances_s(&self) -> Vec<f64> {
        conductances_s(&self.skin, &self.body, self.built.as_deref())
    }

    /// Volts per relative change of each element's conductance: channels x elements.
    ///
    /// # Errors
    /// A skin that cannot be solved.
    pub(crate) fn element_sensitivities(&self) -> Result<Jacobian, Error> {
        let sigma = self.conductances_s();
        let (_, mut jacobian) = solved(&self.skin, &self.body, &self.protocol, &sigma, |solution| solution.jacobian())?;
        times_columns(&mut jacobian, &sigma);
        Ok(jacobian)
    }

    /// How the skin was built, if that is known.
    pub(crate) fn build(&self) -> Option<&Arc<Build>> {
        self.built.as_ref()
    }

    /// The same skin with other image settings, without recomputing mesh or fields. The grid and the number of
    /// elements are unchanged.
    ///
    /// # Errors
    /// Settings that would be invalid in a skin file.
    pub fn with_imaging(&self, imaging: Imaging) -> Result<Self, Error> {
        let imaging = Imaging { grid: self.skin.imaging.grid, elements: self.skin.imaging.elements, ..imaging };
        let skin = Skin { imaging, ..self.skin.clone() }.checked()?;
        Ok(Self {
            skin,
            body: self.body.clone(),
            protocol: self.protocol.clone(),
            map: self.map.clone(),
            voltages: self.voltages.clone(),
            jacobian: self.jacobian.clone(),
            basis: self.basis.clone(),
            problem: OnceLock::new(),
            workshop_error: self.workshop_error.clone(),
            change_by_mesh: self.change_by_mesh.clone(),
            built: self.built.clone(),
        })
    }

    /// Number of channels of a frame.
    pub fn channels(&self) -> usize {
        self.voltages.len()
    }

    /// The cells of its images, for touch extraction. Only this function assumes that they are a grid.
    pub(crate) fn image_cells(&self) -> ImageCells {
        let PixelGrid { columns, rows, pixel_m, left_m, top_m } = *self.map.grid();
        ImageCells::from(GridGeometry { columns, rows, pixel_m, left_m, top_m })
    }

    /// Pixels that the skin barely covers and that images exclude, each with the nearest inside pixel (both
    /// row-major). An image that needs a value everywhere on the skin can take it from there.
    pub fn rim_pixels(&self) -> Vec<(usize, usize)> {
        let grid = self.map.grid();
        let away_m = |a: usize, b: usize| distance(grid.centre_m(a), grid.centre_m(b));
        let mask = self.map.inside_mask();
        let on_rim = (0..grid.len()).filter(|&pixel| !mask[pixel] && self.map.coverage()[pixel] > LEAST_RIM_COVERAGE);
        on_rim
            .filter_map(|pixel| {
                let inside = self.map.inside_pixels().iter().map(|&p| p as usize);
                let nearest = inside.min_by(|&a, &b| away_m(pixel, a).total_cmp(&away_m(pixel, b)))?;
                Some((pixel, nearest))
            })
            .collect()
    }

    /// Checks whether a measured baseline (channels in the protocol's order) looks like this skin at rest, and if
    /// not, whether it has another order or the opposite sign.
    pub fn diagnose(&self, baseline: &[f64]) -> OrderReport {
        diagnose_order(&self.protocol, &self.voltages, baseline, self.skin.backend.reads == Reads::Magnitude)
    }

    /// Half the shorter side of the skin, metres.
    pub fn half_width_m(&self) -> f64 {
        let (low, high) = self.body.outline.bounds_m();
        0.5 * (high[0] - low[0]).min(high[1] - low[1])
    }

    /// Minimum distance of two positions that may both explain a frame, metres.
    pub(crate) fn places_apart_m(&self) -> f64 {
        PLACES_APART * self.half_width_m()
    }

    /// Frames that a touch of the skin file's size would give at each of the given positions: rows of difference data
    /// in model volts for a relative change of 1 at its centre, polarity included.
    pub fn signatures(&self, positions_m: &[Point]) -> Vec<f64> {
        let sigma = self.skin.touch.relative_size * self.half_width_m();
        let polarity = self.skin.imaging.polarity.sign();
        let mut rows = Vec::with_capacity(positions_m.len() * self.channels());
        let (mut runs, mut weights) = (Vec::new(), Vec::new());
        for p in positions_m {
            weigh_near(&self.basis.positions, *p, sigma, &mut runs, &mut weights);
            rows.extend((0..self.channels()).map(|channel| {
                let row = self.jacobian.row(channel);
                polarity
                    * runs.iter().map(|(first, run)| inner_product(&weights[run.clone()], &row[*first..])).sum::<f64>()
            }));
        }
        rows
    }

    /// True if the errors of touches on skins as built are known, so that asking for them takes no time.
    pub(crate) fn knows_workshop_error(&self) -> bool {
        self.workshop_error.get().is_some()
    }

    /// Errors of touches on skins built within the file's tolerances, computed by `draw` once.
    pub(crate) fn workshop_error(
        &self,
        draw: impl FnOnce() -> Option<Arc<WorkshopError>>,
    ) -> Option<Arc<WorkshopError>> {
        self.workshop_error.get_or_init(draw).clone()
    }

    /// How much a coarser mesh changes the voltages at rest, computed by `compare` once.
    pub(crate) fn change_by_mesh(&self, compare: impl FnOnce(&Self) -> f64) -> f64 {
        *self.change_by_mesh.get_or_init(|| compare(self))
    }

    /// Voltages at rest of the skin as drawn on a mesh of about this number of elements, volts.
    ///
    /// # Errors
    /// A skin that cannot be meshed or solved.
    pub(crate) fn voltages_with(&self, elements: usize) -> Result<Vec<f64>, Error> {
        let imaging = Imaging { elements, ..self.skin.imaging.clone() };
        let skin = Skin { imaging, ..self.skin.clone() };
        let body = skin.body()?;
        let sigma = conductances_s(&skin, &body, None);
        Ok(ForwardModel::new(body.mesh, self.protocol.clone())?.solve(&sigma)?.voltages())
    }

    /// The stored problem, or one made by `build`, which is stored if `lasts`.
    pub(crate) fn problem(
        &self,
        lasts: bool,
        build: impl FnOnce() -> Result<LinearProblem, Error>,
    ) -> Result<Arc<LinearProblem>, Error> {
        if let Some(problem) = self.problem.get().filter(|_| lasts) {
            return Ok(problem.clone());
        }
        let problem = Arc::new(build()?);
        if lasts {
            // If another thread was faster, both are equal.
            let _ = self.problem.set(problem.clone());
        }
        Ok(problem)
    }

    /// The prior of the skin file in metres.
    pub fn prior(&self) -> Prior {
        prior_of(&self.skin.imaging.prior, self.half_width_m())
    }
}

/// Voltages at rest, volts, and volts per relative change of each inside pixel, with the readout circuit if it is
/// known.
fn electric_model(
    skin: &Skin,
    body: &SkinBody,
    protocol: &Protocol,
    map: &PixelMap,
    build: Option<&Build>,
) -> Result<(Vec<f64>, Jacobian), Error> {
    let conductance = skin.sheet_conductance_s();
    let sigma = conductances_s(skin, body, build);
    let (voltages, mut jacobian) = solved(skin, body, protocol, &sigma, |solution| solution.jacobian_to_pixels(map))?;
    let local: Vec<f64> = match build {
        None => vec![conductance; jacobian.columns],
        Some(build) => map.inside_centres_m().iter().map(|at| conductance * build.conductivity(*at)).collect(),
    };
    times_columns(&mut jacobian, &local);
    Ok((voltages, jacobian))
}

/// Voltages at rest and sensitivities of a sheet with these conductances of its elements, with the readout circuit if
/// it is known.
fn solved(
    skin: &Skin,
    body: &SkinBody,
    protocol: &Protocol,
    sigma: &[f64],
    sensitivities: impl Fn(&Solution<'_>) -> Jacobian,
) -> Result<(Vec<f64>, Jacobian), Error> {
    let model = ForwardModel::new(body.mesh.clone(), protocol.clone())?;
    let solution = model.solve(sigma)?;
    Ok(match skin.backend.circuit.as_ref().and_then(CircuitChoice::known) {
        None => (solution.voltages(), sensitivities(&solution)),
        Some(circuit) => {
            let response = circuit.readout().response(&solution, skin.sheet_conductance_s())?;
            let effective = ForwardModel::new(body.mesh.clone(), response.effective)?;
            (response.voltages, sensitivities(&effective.solve(sigma)?))
        }
    })
}

/// Multiplies each column by a factor.
fn times_columns(jacobian: &mut Jacobian, factors: &[f64]) {
    for row in jacobian.values.chunks_exact_mut(factors.len().max(1)) {
        row.iter_mut().zip(factors).for_each(|(value, factor)| *value *= factor);
    }
}

/// A mesh of the sheet as drawn with its electrodes where they are as built, and the conductance of its elements,
/// siemens. `body` has the outline and the electrodes as drawn.
///
/// # Errors
/// Manufacturing errors that cannot be built.
pub(crate) fn sheet_as_built(
    skin: &Skin,
    body: &SkinBody,
    build: Option<&Build>,
    drawn: ElectrodedMesh,
) -> Result<(ElectrodedMesh, Vec<f64>), Error> {
    let mut body = SkinBody { mesh: drawn, ..body.clone() };
    if let Some(build) = build {
        body.mesh = build.moved(&body).map_err(|source| Error::Mesh { skin: skin.name.clone(), source })?;
    }
    let sheet_s = conductances_s(skin, &body, build);
    Ok((body.mesh, sheet_s))
}

/// Sheet conductance of every element at rest, siemens.
fn conductances_s(skin: &Skin, body: &SkinBody, build: Option<&Build>) -> Vec<f64> {
    let (mesh, conductance) = (&body.mesh.mesh, skin.sheet_conductance_s());
    let relative = |element: usize| {
        let [x, y, _] = mesh.centroid(element);
        build.map_or(1.0, |build| build.conductivity([x, y]))
    };
    (0..mesh.element_count()).map(|element| conductance * relative(element)).collect()
}

/// Weights exp(-d^2 / 2 sigma^2) of the cells within four sigma of a position, in runs of consecutive cells. Each run
/// has its first cell and the range of its weights.
fn weigh_near(
    cells_m: &[[f64; 3]],
    place_m: Point,
    sigma_m: f64,
    runs: &mut Vec<(usize, Range<usize>)>,
    weights: &mut Vec<f64>,
) {
    runs.clear();
    weights.clear();
    for (cell, at) in cells_m.iter().enumerate() {
        let distance = ((at[0] - place_m[0]).powi(2) + (at[1] - place_m[1]).powi(2)) / (sigma_m * sigma_m);
        if distance >= 16.0 {
            continue;
        }
        let next = weights.len();
        match runs.last_mut() {
            Some((first, run)) if *first + run.len() == cell => run.end = next + 1,
            _ => runs.push((cell, next..next + 1)),
        }
        weights.push((-0.5 * distance).exp());
    }
}

fn prior_of(choice: &PriorChoice, half_width_m: f64) -> Prior {
    match choice {
        PriorChoice::Identity => Prior::Identity,
        PriorChoice::Laplace => Prior::Laplace,
        PriorChoice::Noser(exponent) => Prior::Noser { exponent: *exponent },
        PriorChoice::GaussianMm(length) => Prior::Gaussian { correlation_length_m: length * 1e-3 },
        PriorChoice::Balanced { relative_length, exponent } => {
            Prior::GaussianNoser { correlation_length_m: relative_length * half_width_m, exponent: *exponent }
        }
        PriorChoice::Mixture(parts) => {
            let part = |MixturePart { weight, prior }: &MixturePart| (*weight, prior_of(prior, half_width_m));
            Prior::Mixture(parts.iter().map(part).collect())
        }
    }
}

/// Inside pixels as unknowns: centres, and neighbours that share a side.
fn pixel_basis(map: &PixelMap) -> ImageBasis {
    let grid = map.grid();
    let mut number = vec![u32::MAX; grid.len()];
    for (unknown, &pixel) in map.inside_pixels().iter().enumerate() {
        number[pixel as usize] = unknown as u32;
    }
    let mut neighbours = Vec::new();
    for row in 0..grid.rows {
        for column in 0..grid.columns {
            let here = number[row * grid.columns + column];
            let right = (column + 1 < grid.columns).then(|| number[row * grid.columns + column + 1]);
            let below = (row + 1 < grid.rows).then(|| number[(row + 1) * grid.columns + column]);
            for other in [right, below].into_iter().flatten() {
                if here != u32::MAX && other != u32::MAX {
                    neighbours.push([here, other]);
                }
            }
        }
    }
    let positions = map.inside_centres_m().into_iter().map(|p| [p[0], p[1], 0.0]).collect();
    ImageBasis { positions, neighbours }
}
