//! Places of other conductance than the sheet about them: elements that differ surely, joined where they share a side.

use dermis_tomo::mesh::Mesh;

use super::Region;

/// Standard deviations by which an element of a region differs at least.
const LEAST_DEVIATIONS: f64 = 3.0;
/// Log conductance by which it differs at least: 5 %.
const LEAST_DIFFERENCE: f64 = 0.05;
/// A region's conductance is the mean where it differs by more than this share of its most.
const CORE: f64 = 0.75;
/// A region reaches as far as half its largest difference.
const RIM: f64 = 0.5;
/// Most regions in a report.
const MOST: usize = 12;

/// The regions, the largest difference first. `deviations`: of log conductance.
pub(super) fn regions(mesh: &Mesh, conductances: &[f64], deviations: &[f64], sheet_s: f64) -> Vec<Region> {
    let difference: Vec<f64> = conductances.iter().map(|s| (s / sheet_s).ln()).collect();
    let differs =
        |k: usize| difference[k].abs() > LEAST_DIFFERENCE.max(LEAST_DEVIATIONS * deviations[k]);
    let mut neighbours = vec![Vec::new(); difference.len()];
    for &[a, b] in mesh.neighbours().iter() {
        neighbours[a as usize].push(b as usize);
        neighbours[b as usize].push(a as usize);
    }
    let mut seen = vec![false; difference.len()];
    let mut found = Vec::new();
    for start in 0..difference.len() {
        if seen[start] || !differs(start) {
            continue;
        }
        seen[start] = true;
        let (mut members, mut next) = (Vec::new(), vec![start]);
        while let Some(element) = next.pop() {
            members.push(element);
            for &other in &neighbours[element] {
                if !seen[other] && differs(other) && difference[other] * difference[start] > 0.0 {
                    seen[other] = true;
                    next.push(other);
                }
            }
        }
        found.push(region(mesh, &members, conductances, deviations, &difference));
    }
    found.sort_by(|a, b| b.0.total_cmp(&a.0));
    found.into_iter().take(MOST).map(|(_, region)| region).collect()
}

/// One region with its largest difference.
fn region(
    mesh: &Mesh,
    members: &[usize],
    conductances: &[f64],
    deviations: &[f64],
    difference: &[f64],
) -> (f64, Region) {
    let most = members.iter().map(|&k| difference[k].abs()).fold(0.0, f64::max);
    let above = |share: f64| members.iter().copied().filter(move |&k| difference[k].abs() >= share * most);
    let area = |elements: &mut dyn Iterator<Item = usize>| elements.map(|k| mesh.measures()[k]).sum::<f64>();
    let (core, whole) = (area(&mut above(CORE)), area(&mut above(RIM)));
    let mean = |values: &dyn Fn(usize) -> f64, share: f64, area: f64| {
        above(share).map(|k| mesh.measures()[k] * values(k)).sum::<f64>() / area
    };
    let conductance_s = mean(&|k| conductances[k], CORE, core);
    let region = Region {
        x_m: mean(&|k| mesh.centroid(k)[0], RIM, whole),
        y_m: mean(&|k| mesh.centroid(k)[1], RIM, whole),
        radius_m: (whole / std::f64::consts::PI).sqrt(),
        conductance_s,
        sigma_s: conductance_s * mean(&|k| deviations[k], CORE, core),
    };
    (most, region)
}
