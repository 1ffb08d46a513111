//! Effect of a straight cut on the voltages of a sheet, from the fields of the intact sheet alone.
//!
//! Across a cut of half length a the potential jumps by `w(x) = sum_k c_k sqrt(1 - x^2) U_k(x)`, `x` in units of a,
//! `U_k` the Chebyshev polynomials of the second kind, for which the normal field of the jump is
//! `-(k + 1) c_k U_k / 2a` (finite part of `(1/pi) int sqrt(1-t^2) U_k / (x-t)^2 dt = -(k+1) U_k`; Hills, Kelly, Dai
//! and Korsunsky, *Solution of Crack Problems*, 1996). The current across it is `s E_n = g w`, with s the conductance
//! of the sheet and g the conductance of the joined faces per length. With `l = s/g` and E the normal field of the
//! intact sheet, `sum_k ((pi/4a) (l+1) delta_lk + M_lk / l) c_k = (pi/2) e_l`, and by reciprocity a channel changes
//! by `s int w E' dx`, E' the adjoint field. The rim's response to the cut is neglected: it is of order (a /
//! distance)^2 / 4.

use dermis_skin::Modality;
use dermis_tomo::eit::{ForwardModel, Pattern, Protocol};
use dermis_tomo::mesh::{PixelGrid, Point};

use crate::Error;
use crate::prepare::Prepared;

/// Number of Chebyshev terms.
const TERMS: usize = 5;
/// Number of points along a cut.
const POINTS: usize = 10;

/// A straight cut in the model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Crack {
    /// Centre, metres.
    pub centre_m: Point,
    /// Length, metres.
    pub length_m: f64,
    /// Direction, counter-clockwise from +x.
    pub direction_rad: f64,
    /// 1/l: conductance of its partly joined faces relative to the sheet's; 0 when open. 1/m.
    pub joined_per_m: f64,
}

/// Computes the response of a prepared sheet to cuts.
#[derive(Debug)]
pub struct CrackModel {
    grid: PixelGrid,
    /// Fields -grad u of every drive, then of every measuring pattern, at each pixel; NaN outside.
    fields: Vec<[f64; 2]>,
    drives: usize,
    patterns: usize,
    /// Drive and pattern of each channel.
    channels: Vec<[u32; 2]>,
    sheet_s: f64,
    /// Points, weights and values of the polynomials at them.
    points: [(f64, f64, [f64; TERMS]); POINTS],
    /// M: products of the jump shapes.
    overlap: [[f64; TERMS]; TERMS],
}

impl CrackModel {
    /// True if cuts can be fitted: on flat sheets that are read by electrodes without a readout circuit.
    pub fn applies_to(prepared: &Prepared) -> bool {
        let skin = &prepared.skin;
        skin.modality == Modality::Eit && skin.backend.circuit.is_none() && skin.frontend.bend.is_none()
    }

    /// A model from the fields of the resting sheet.
    ///
    /// # Errors
    /// A forward problem that cannot be solved.
    pub fn new(prepared: &Prepared) -> Result<Self, Error> {
        let (protocol, map) = (&prepared.protocol, &prepared.map);
        let electrodes = protocol.electrode_count();
        let mut all = protocol.stimulations().to_vec();
        all.extend(protocol.patterns().iter().map(|pattern| balanced(pattern, electrodes)));
        // A protocol must measure something; only its drives are needed here.
        let read = vec![(protocol.pattern_of(0).clone(), 0)];
        let fields_of = Protocol::from_patterns(electrodes, all, read)
            .map_err(|source| Error::Protocol { skin: prepared.skin.name.clone(), source })?;
        let model = ForwardModel::new(prepared.body.mesh.clone(), fields_of)?;
        let mesh = &model.body().mesh;
        let sheet_s = prepared.skin.sheet_conductance_s();
        let sigma = vec![sheet_s; mesh.element_count()];
        let solution = model.solve(&sigma)?;
        let (drives, count) = (protocol.stimulations().len(), model.protocol().stimulations().len());
        let grid = *map.grid();
        let mut fields = vec![[f64::NAN; 2]; count * grid.len()];
        for index in 0..count {
            let density = solution.current_density(index, &sigma);
            for axis in 0..2 {
                let per_element: Vec<f64> = density.iter().map(|vector| vector[axis] / sheet_s).collect();
                let named = |source| Error::Mesh { skin: prepared.skin.name.clone(), source };
                let inside = map.to_inside(&per_element).map_err(named)?;
                for (&pixel, value) in map.inside_pixels().iter().zip(inside) {
                    fields[pixel as usize * count + index][axis] = value;
                }
            }
        }
        let channels = protocol.measurements().iter().map(|m| [m.stimulation, m.pattern]).collect();
        let points = chebyshev_points();
        let overlap = overlaps();
        Ok(Self { grid, fields, drives, patterns: count - drives, channels, sheet_s, points, overlap })
    }

    /// Number of channels in a response.
    pub fn channel_count(&self) -> usize {
        self.channels.len()
    }

    /// Change of every channel due to a cut, model volts, into `response`. False if the cut leaves the skin.
    pub fn respond(&self, crack: &Crack, scratch: &mut CrackScratch, response: &mut [f64]) -> bool {
        let half_m = 0.5 * crack.length_m;
        let (sin, cos) = crack.direction_rad.sin_cos();
        let count = self.drives + self.patterns;
        let CrackScratch { fields, modes, jumps } = scratch;
        modes.clear();
        modes.resize(count, [0.0; TERMS]);
        for (x, weight, values) in &self.points {
            let along = half_m * x;
            let place = [crack.centre_m[0] + along * cos, crack.centre_m[1] + along * sin];
            if !self.fields_at(place, fields) {
                return false;
            }
            let shares = values.map(|value| weight * value);
            for (modes, [x, y]) in modes.iter_mut().zip(&*fields) {
                let normal = cos * y - sin * x;
                modes.iter_mut().zip(shares).for_each(|(mode, share)| *mode += share * normal);
            }
        }
        // The modes hold (pi/2) e_k. The system of an open cut is diagonal.
        let diagonal: [f64; TERMS] =
            std::array::from_fn(|row| std::f64::consts::PI * (row + 1) as f64 / (4.0 * half_m));
        jumps.clear();
        if crack.joined_per_m == 0.0 {
            let jump = |modes: &[f64; TERMS]| std::array::from_fn(|k| modes[k] / diagonal[k]);
            jumps.extend(modes[..self.drives].iter().map(jump));
        } else {
            let mut system = self.overlap.map(|row| row.map(|entry| entry * crack.joined_per_m));
            (0..TERMS).for_each(|k| system[k][k] += diagonal[k]);
            jumps.extend(modes[..self.drives].iter().map(|modes| solve(system, *modes)));
        }
        for (value, [drive, pattern]) in response.iter_mut().zip(&self.channels) {
            let (jump, modes) = (&jumps[*drive as usize], &modes[self.drives + *pattern as usize]);
            *value = self.sheet_s * half_m * jump.iter().zip(modes).map(|(c, e)| c * e).sum::<f64>();
        }
        true
    }

    /// Change of every channel due to a short open cut at a place, per squared half length, model volts per square
    /// metre: with normal n, `s pi (n E) (n E')`. Into `responses` go the factors of `n_x^2`, `n_x n_y` and `n_y^2`.
    /// False if the place is outside the skin.
    pub(super) fn respond_short(
        &self,
        place: Point,
        scratch: &mut CrackScratch,
        responses: &mut [Vec<f64>; 3],
    ) -> bool {
        let fields = &mut scratch.fields;
        if !self.fields_at(place, fields) {
            return false;
        }
        let factor = self.sheet_s * std::f64::consts::PI;
        responses.iter_mut().for_each(|response| response.clear());
        for [drive, pattern] in &self.channels {
            let ([x, y], [u, v]) = (fields[*drive as usize], fields[self.drives + *pattern as usize]);
            for (response, product) in responses.iter_mut().zip([x * u, x * v + y * u, y * v]) {
                response.push(factor * product);
            }
        }
        true
    }

    /// The fields at a point, into `fields`. False if it is outside the skin.
    fn fields_at(&self, place: Point, fields: &mut Vec<[f64; 2]>) -> bool {
        let Some(corners) = self.corners(place) else { return false };
        let count = self.drives + self.patterns;
        fields.clear();
        fields.resize(count, [0.0; 2]);
        for (pixel, share) in corners {
            for (field, [x, y]) in fields.iter_mut().zip(&self.fields[pixel * count..][..count]) {
                (field[0], field[1]) = (field[0] + share * x, field[1] + share * y);
            }
        }
        true
    }

    /// The pixels around a point with their weights in bilinear interpolation, without those outside the skin.
    fn corners(&self, [x, y]: Point) -> Option<[(usize, f64); 4]> {
        let count = self.drives + self.patterns;
        let column = (x - self.grid.left_m) / self.grid.pixel_m - 0.5;
        let row = (self.grid.top_m - y) / self.grid.pixel_m - 0.5;
        let (c0, r0) = (column.floor(), row.floor());
        let (fx, fy) = (column - c0, row - r0);
        let mut corners = [(0, 0.0); 4];
        let mut total = 0.0;
        for (slot, (dc, dr)) in corners.iter_mut().zip([(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)]) {
            let (c, r) = (c0 + dc, r0 + dr);
            if c < 0.0 || r < 0.0 || c >= self.grid.columns as f64 || r >= self.grid.rows as f64 {
                continue;
            }
            let pixel = r as usize * self.grid.columns + c as usize;
            if self.fields[pixel * count][0].is_nan() {
                continue;
            }
            let share = (1.0 - (fx - dc).abs()) * (1.0 - (fy - dr).abs());
            *slot = (pixel, share);
            total += share;
        }
        if total < 0.2 {
            return None;
        }
        // Outside there is no field, not even for a share of zero.
        let (inside, _) = *corners.iter().find(|corner| corner.1 > 0.0)?;
        Some(corners.map(|(pixel, share)| if share > 0.0 { (pixel, share / total) } else { (inside, 0.0) }))
    }
}

/// A pattern as currents; if they do not sum to zero, the rest returns evenly through all electrodes.
fn balanced(pattern: &Pattern, electrodes: usize) -> Pattern {
    let mean = pattern.sum() / electrodes as f64;
    let returned = (0..electrodes as u32).map(|electrode| (electrode, -mean));
    Pattern::new(pattern.entries().iter().copied().chain(returned).collect())
}

/// Working memory for responses.
#[derive(Debug, Default)]
pub struct CrackScratch {
    /// Fields at one point.
    fields: Vec<[f64; 2]>,
    modes: Vec<[f64; TERMS]>,
    jumps: Vec<[f64; TERMS]>,
}

/// Gauss-Chebyshev points of the second kind, with weights for `int sqrt(1-x^2) f dx`.
fn chebyshev_points() -> [(f64, f64, [f64; TERMS]); POINTS] {
    std::array::from_fn(|index| {
        let angle = std::f64::consts::PI * (index + 1) as f64 / (POINTS + 1) as f64;
        let weight = std::f64::consts::PI / (POINTS + 1) as f64 * angle.sin().powi(2);
        let values = std::array::from_fn(|k| ((k + 1) as f64 * angle).sin() / angle.sin());
        (angle.cos(), weight, values)
    })
}

/// `M_kl = int (1 - x^2) U_k U_l dx`, in x = cos t: `int sin((k+1) t) sin((l+1) t) sin t dt` over 0 to pi, in closed
/// form.
fn overlaps() -> [[f64; TERMS]; TERMS] {
    std::array::from_fn(|k| {
        std::array::from_fn(|l| {
            let term = |n: f64| if (n as i64).rem_euclid(2) == 0 { 2.0 / (1.0 - n * n) } else { 0.0 };
            let (p, q) = ((k + 1) as f64, (l + 1) as f64);
            // int cos(n t) sin t dt = 2 / (1 - n^2) for even n, 0 for odd.
            0.5 * (term(p - q) - term(p + q))
        })
    })
}

/// Solves a small symmetric positive system by elimination.
fn solve(mut matrix: [[f64; TERMS]; TERMS], mut right: [f64; TERMS]) -> [f64; TERMS] {
    for pivot in 0..TERMS {
        for row in pivot + 1..TERMS {
            let factor = matrix[row][pivot] / matrix[pivot][pivot];
            for column in pivot..TERMS {
                matrix[row][column] -= factor * matrix[pivot][column];
            }
            right[row] -= factor * right[pivot];
        }
    }
    for row in (0..TERMS).rev() {
        let known: f64 = (row + 1..TERMS).map(|column| matrix[row][column] * right[column]).sum();
        right[row] = (right[row] - known) / matrix[row][row];
    }
    right
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn overlaps_are_the_integrals() {
        let overlap = overlaps();
        for (k, row) in overlap.iter().enumerate() {
            for (l, value) in row.iter().enumerate() {
                // Midpoints of a fine division: errors of order 1e-8.
                let sum: f64 = (0..20_000)
                    .map(|i| {
                        let t = std::f64::consts::PI * (f64::from(i) + 0.5) / 20_000.0;
                        ((k + 1) as f64 * t).sin() * ((l + 1) as f64 * t).sin() * t.sin()
                    })
                    .sum::<f64>()
                    * std::f64::consts::PI
                    / 20_000.0;
                assert!((value - sum).abs() < 1e-6, "{k} {l}: {value} {sum}");
            }
        }
    }

    #[test]
    fn small_systems_are_solved() {
        let mut matrix = overlaps();
        (0..TERMS).for_each(|k| matrix[k][k] += 2.0);
        let expected = [1.0, -2.0, 0.5, 3.0, -1.0];
        let right = std::array::from_fn(|row| (0..TERMS).map(|c| matrix[row][c] * expected[c]).sum());
        let found = solve(matrix, right);
        assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-12), "{found:?}");
    }
}
