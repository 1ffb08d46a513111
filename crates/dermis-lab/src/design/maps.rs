//! Maps of a skin's sensitivity, its smallest detectable amplitude, and the bounds on position and amplitude.

use dermis_live::imager::Imager;
use dermis_tomo::mesh::{PixelGrid, PixelMap, Point, distance};
use dermis_tomo::quality::spread_width_m;
use rayon::prelude::*;

use crate::Error;
use dermis_live::prepare::Prepared;
use dermis_live::reference::Reference;

/// Detection limit in standard deviations (the limit of detection of paper P).
pub const DETECTED_SIGMA: f64 = 3.3;
/// Share of the weakest area that "worst" leaves out: the outer rim, which no finger touches.
const OUTERMOST_SHARE: f64 = 0.1;
/// Step of the finite differences in position, relative to the size of a touch. The error grows with its square.
const STEP_SHARE: f64 = 0.05;

/// Maps over a skin: one value per place, in the order of [`Maps::places_m`].
#[derive(Clone, Debug)]
pub struct Maps {
    /// Places, metres.
    pub places_m: Vec<Point>,
    /// Pixel of each place.
    pub pixels: Vec<usize>,
    /// Grid of the maps.
    pub grid: PixelGrid,
    /// `|s| / noise`: signal-to-noise ratio of all channels together for a relative change of 1.
    pub sensitivity: Vec<f64>,
    /// Smallest detectable relative change.
    pub smallest: Vec<f64>,
    /// Bound on the standard deviation of a position along its worse axis, metres, at [`Maps::amplitude`].
    pub position_m: Vec<f64>,
    /// Bound on the standard deviation of the amplitude, relative to the amplitude.
    pub amplitude_share: Vec<f64>,
    /// Amplitude that the bounds hold for: a relative change of conductivity.
    pub amplitude: f64,
}

/// A map summarised in three numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Summary {
    /// The worst place, excluding the weakest tenth of the area.
    pub worst: f64,
    /// The median place.
    pub median: f64,
    /// The best place.
    pub best: f64,
}

/// Channel noise assumed by the design.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Noise {
    /// The skin file's assumption: equal for every channel, a share of the largest voltage.
    Assumed,
    /// Equal for every channel, volts: an instrument whose noise doesn't depend on the reading.
    Volts(f64),
    /// Proportional to each channel's own voltage, `20 log10(|V| / deviation)` decibels, but at least a hundredth of
    /// the assumed noise.
    Decibels(f64),
}

impl Noise {
    fn deviations(self, prepared: &Prepared, reference: &Reference) -> Vec<f64> {
        match self {
            Self::Assumed => reference.noise.clone(),
            Self::Volts(volts) => vec![volts; reference.noise.len()],
            Self::Decibels(db) => {
                let share = 10_f64.powf(-db / 20.0);
                let least = reference.noise.iter().map(|noise| 0.01 * noise);
                prepared.voltages.iter().zip(least).map(|(v, least)| (share * v.abs()).max(least)).collect()
            }
        }
    }
}

impl Maps {
    /// Maps of a prepared skin for touches of the given amplitude, on a grid of at most `along` places per side.
    ///
    /// # Errors
    /// The amplitude or noise is not positive and finite, or the grid is invalid.
    pub fn new(prepared: &Prepared, noise: Noise, amplitude: f64, along: usize) -> Result<Self, Error> {
        let positive = |what: &str, value: f64| {
            if value > 0.0 && value.is_finite() {
                return Ok(());
            }
            Err(Error::Live(dermis_live::Error::Frames {
                what: what.into(),
                expected: "a positive number".into(),
                got: value.to_string(),
            }))
        };
        positive("amplitude", amplitude)?;
        match noise {
            Noise::Assumed => {}
            Noise::Volts(volts) => positive("noise (V)", volts)?,
            Noise::Decibels(db) => positive("signal-to-noise ratio (dB)", db)?,
        }
        let reference = Reference::from_baseline(prepared, &prepared.voltages, None)?;
        let deviations = noise.deviations(prepared, &reference);
        let (grid, map) = places(prepared, along)?;
        let places_m = map.inside_centres_m();
        let step = STEP_SHARE * prepared.skin.touch.relative_size * prepared.half_width_m();
        let figures: Vec<[f64; 4]> =
            places_m.par_iter().map(|&place| bounds_at(prepared, &deviations, place, step, amplitude)).collect();
        let column = |k: usize| figures.iter().map(|f| f[k]).collect::<Vec<f64>>();
        Ok(Self {
            pixels: map.inside_pixels().iter().map(|&pixel| pixel as usize).collect(),
            grid,
            places_m,
            sensitivity: column(0),
            smallest: column(1),
            position_m: column(2),
            amplitude_share: column(3),
            amplitude,
        })
    }

    /// A map as a row-major image, NaN outside the skin.
    pub fn image(&self, values: &[f64]) -> Vec<f32> {
        scattered(&self.grid, &self.pixels, values)
    }
}

/// The grid of a map with at most `along` places per side, and the skin's pixels on it.
pub(super) fn places(prepared: &Prepared, along: usize) -> Result<(PixelGrid, PixelMap), Error> {
    let (low, high) = prepared.body.outline.bounds_m();
    let mesh_error = |source| Error::Live(dermis_live::Error::Mesh { skin: prepared.skin.name.clone(), source });
    let grid = PixelGrid::covering(low, high, along).map_err(mesh_error)?;
    let map = PixelMap::new(grid, &prepared.body.mesh.mesh).map_err(mesh_error)?;
    Ok((grid, map))
}

/// Values of some pixels as a row-major image, NaN elsewhere.
pub(super) fn scattered(grid: &PixelGrid, pixels: &[usize], values: &[f64]) -> Vec<f32> {
    let mut image = vec![f32::NAN; grid.len()];
    for (&pixel, &value) in pixels.iter().zip(values) {
        image[pixel] = value as f32;
    }
    image
}

impl Summary {
    /// Summarises a map in which smaller values are better.
    pub fn of(values: &[f64]) -> Self {
        let mut sorted = values.to_vec();
        sorted.sort_by(f64::total_cmp);
        let at =
            |share: f64| sorted.get((share * (sorted.len().max(1) - 1) as f64) as usize).copied().unwrap_or(f64::NAN);
        Self { worst: at(1.0 - OUTERMOST_SHARE), median: at(0.5), best: at(0.0) }
    }
}

/// Sensitivity, smallest amplitude, position bound (worse axis, metres) and relative amplitude bound at one place.
fn bounds_at(prepared: &Prepared, deviations: &[f64], [x, y]: Point, step: f64, amplitude: f64) -> [f64; 4] {
    let places = [[x, y], [x + step, y], [x - step, y], [x, y + step], [x, y - step]];
    let rows = prepared.signatures(&places);
    let channels = deviations.len();
    let row = |k: usize| &rows[k * channels..(k + 1) * channels];
    // Columns of C^-1/2 G.
    let mut columns = [vec![0.0; channels], vec![0.0; channels], vec![0.0; channels]];
    for channel in (0..channels).filter(|&channel| deviations[channel] > 0.0) {
        let weight = 1.0 / deviations[channel];
        columns[0][channel] = weight * amplitude * (row(1)[channel] - row(2)[channel]) / (2.0 * step);
        columns[1][channel] = weight * amplitude * (row(3)[channel] - row(4)[channel]) / (2.0 * step);
        columns[2][channel] = weight * row(0)[channel];
    }
    let dot = |a: usize, b: usize| columns[a].iter().zip(&columns[b]).map(|(p, q)| p * q).sum::<f64>();
    let energy = dot(2, 2);
    // Information about the position after accounting for the unknown amplitude, and the other way round (Schur
    // complement).
    let left = |a: usize, b: usize| dot(a, b) - dot(a, 2) * dot(b, 2) / energy;
    let [xx, xy, yy] = [left(0, 0), left(0, 1), left(1, 1)];
    let half = 0.5 * (xx + yy);
    let least_information = half - (0.25 * (xx - yy).powi(2) + xy * xy).sqrt();
    let [pxx, pxy, pyy] = [dot(0, 0), dot(0, 1), dot(1, 1)];
    let determinant = pxx * pyy - pxy * pxy;
    let [cx, cy] = [dot(0, 2), dot(1, 2)];
    let taken = (pyy * cx * cx - 2.0 * pxy * cx * cy + pxx * cy * cy) / determinant;
    let root = |information: f64| if information > 0.0 { information.sqrt().recip() } else { f64::INFINITY };
    [energy.sqrt(), DETECTED_SIGMA * root(energy), root(least_information), root(energy - taken) / amplitude]
}

/// Width of a point's image at each place of the maps, metres.
///
/// This is the diameter of a disc with the area of the region at half the peak or more (the resolution figure of
/// GREIT, Adler et al., Physiol. Meas. 30, 2009, S35, as a length). The point is one pixel of the skin's image grid;
/// the operator is the skin file's. NaN if the image has no peak of the right sign.
///
/// # Errors
/// The operator cannot be built from the model alone.
pub fn spread_width(prepared: &Prepared, maps: &Maps) -> Result<Vec<f64>, Error> {
    let reference = Reference::from_baseline(prepared, &prepared.voltages, None)?;
    let mut imager = Imager::new(prepared, &reference, &[prepared.signatures(&[[0.0, 0.0]])])?;
    let (grid, positions) = (prepared.map.grid(), &prepared.basis.positions);
    let polarity = prepared.skin.imaging.polarity.sign();
    let mut image = vec![f32::NAN; grid.len()];
    let mut widths = Vec::with_capacity(maps.places_m.len());
    for place_m in &maps.places_m {
        let away_m = |k: usize| distance([positions[k][0], positions[k][1]], *place_m);
        let nearest = (0..positions.len()).min_by(|&a, &b| away_m(a).total_cmp(&away_m(b)));
        let Some(pixel) = nearest else { continue };
        let point: Vec<f64> = (0..prepared.channels()).map(|c| polarity * prepared.jacobian.row(c)[pixel]).collect();
        imager.image(&point, &mut image)?;
        let values: Vec<f64> = image.iter().map(|value| f64::from(*value)).collect();
        widths.push(spread_width_m(&values, grid, 1.0).unwrap_or(f64::NAN));
    }
    Ok(widths)
}
