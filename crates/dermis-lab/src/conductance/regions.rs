//! Regions that differ from the sheet around them: the mean over a neighbourhood must differ by three standard
//! deviations. A region extends to half of its largest difference.

use dermis_tomo::mesh::Mesh;
use faer::Mat;
use serde::Serialize;

/// Correlation length of the conductance, in radii of a disc with the sheet's area.
const LENGTH: f64 = 0.12;
/// Number of neighbourhoods to test.
const NEIGHBOURHOODS: usize = 300;
/// Minimum difference of a neighbourhood's mean, in standard deviations.
const LEAST_DEVIATIONS: f64 = 3.0;
/// Minimum difference of a neighbourhood's mean in log conductance: 5 %.
const LEAST_DIFFERENCE: f64 = 0.05;
/// A region's conductance is its mean over the core, where the difference exceeds this share of its maximum. For a
/// round inclusion of one and a half prior lengths, this is accurate to a per cent.
const CORE: f64 = 0.7;
/// A region reaches to where its difference falls to this share of the maximum.
const RIM: f64 = 0.5;
/// Maximum number of regions in a report.
const MOST: usize = 12;

/// A region that differs from the sheet around it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Region {
    /// Centre, metres.
    pub x_m: f64,
    /// Centre, metres.
    pub y_m: f64,
    /// Radius of a disc with its area, metres.
    pub radius_m: f64,
    /// Its conductance, siemens.
    pub conductance_s: f64,
    /// Standard deviation of the conductance, siemens.
    pub sigma_s: f64,
}

/// Finds the regions, largest difference first. `deviations_of` returns standard deviations of weighted means of log
/// conductance; each column of its argument holds one mean's weights over the elements.
pub(super) fn regions(
    mesh: &Mesh,
    conductances: &[f64],
    sheet_s: f64,
    deviations_of: &dyn Fn(&Mat<f64>) -> Vec<f64>,
) -> Vec<Region> {
    let difference: Vec<f64> = conductances.iter().map(|s| (s / sheet_s).ln()).collect();
    let elements = difference.len();
    let mut neighbours = vec![Vec::new(); elements];
    for [a, b] in mesh.neighbours() {
        neighbours[a as usize].push(b as usize);
        neighbours[b as usize].push(a as usize);
    }
    let step = elements.div_ceil(NEIGHBOURHOODS).max(1);
    let centres: Vec<usize> = (0..elements).step_by(step).collect();
    let weights = neighbourhoods(mesh, &centres);
    let deviations = deviations_of(&weights);
    let mean = |column: usize| (0..elements).map(|k| weights[(k, column)] * difference[k]).sum::<f64>();
    let mut seen = vec![false; elements];
    let mut found: Vec<(f64, Region)> = Vec::new();
    for (column, &centre) in centres.iter().enumerate() {
        let mean = mean(column);
        if mean.abs() < LEAST_DIFFERENCE.max(LEAST_DEVIATIONS * deviations[column]) {
            continue;
        }
        // Climb to the largest difference, then grow the region down to half of it.
        let height = |k: usize| difference[k] * mean.signum();
        let mut top = centre;
        while let Some(&higher) = neighbours[top].iter().max_by(|a, b| height(**a).total_cmp(&height(**b)))
            && height(higher) > height(top)
        {
            top = higher;
        }
        if seen[top] {
            continue;
        }
        let (mut members, mut next, mut taken) = (Vec::new(), vec![top], vec![false; elements]);
        taken[top] = true;
        while let Some(element) = next.pop() {
            members.push(element);
            for &other in &neighbours[element] {
                if !taken[other] && height(other) >= RIM * height(top) {
                    taken[other] = true;
                    next.push(other);
                }
            }
        }
        let is_known = members.iter().any(|&element| seen[element]);
        members.iter().for_each(|&element| seen[element] = true);
        if !is_known {
            found.push((height(top), region(mesh, &members, conductances, &difference, deviations_of)));
        }
    }
    found.sort_by(|a, b| b.0.total_cmp(&a.0));
    found.into_iter().take(MOST).map(|(_, region)| region).collect()
}

/// Weights for means around the given elements, one mean per column, falling off over the prior's length.
fn neighbourhoods(mesh: &Mesh, centres: &[usize]) -> Mat<f64> {
    let length = length_m(mesh);
    let mut weights = Mat::from_fn(mesh.element_count(), centres.len(), |element, column| {
        let (a, b) = (mesh.centroid(element), mesh.centroid(centres[column]));
        let square = (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f64>();
        mesh.measures()[element] * (-0.5 * square / (length * length)).exp()
    });
    for column in 0..centres.len() {
        let sum: f64 = (0..weights.nrows()).map(|row| weights[(row, column)]).sum();
        (0..weights.nrows()).for_each(|row| weights[(row, column)] /= sum);
    }
    weights
}

fn region(
    mesh: &Mesh,
    members: &[usize],
    conductances: &[f64],
    difference: &[f64],
    deviations_of: &dyn Fn(&Mat<f64>) -> Vec<f64>,
) -> Region {
    let most = members.iter().map(|&k| difference[k].abs()).fold(0.0, f64::max);
    let area = |elements: &[usize]| elements.iter().map(|&k| mesh.measures()[k]).sum::<f64>();
    let core: Vec<usize> = members.iter().copied().filter(|&k| difference[k].abs() >= CORE * most).collect();
    let (core_m2, whole_m2) = (area(&core), area(members));
    let mean = |values: &dyn Fn(usize) -> f64, elements: &[usize], area: f64| {
        elements.iter().map(|&k| mesh.measures()[k] * values(k)).sum::<f64>() / area
    };
    let mut weights = Mat::zeros(difference.len(), 1);
    core.iter().for_each(|&k| weights[(k, 0)] = mesh.measures()[k] / core_m2);
    let conductance_s = mean(&|k| conductances[k], &core, core_m2);
    Region {
        x_m: mean(&|k| mesh.centroid(k)[0], members, whole_m2),
        y_m: mean(&|k| mesh.centroid(k)[1], members, whole_m2),
        radius_m: (whole_m2 / std::f64::consts::PI).sqrt(),
        conductance_s,
        sigma_s: conductance_s * deviations_of(&weights)[0],
    }
}

/// Correlation length of the conductance, metres.
pub(super) fn length_m(mesh: &Mesh) -> f64 {
    LENGTH * (mesh.measures().iter().sum::<f64>() / std::f64::consts::PI).sqrt()
}
