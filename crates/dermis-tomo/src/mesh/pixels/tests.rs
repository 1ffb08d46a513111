//! Tests of pixels: exact overlaps against sampling, sums, masks, and conversion between elements and pixels.

use super::*;
use crate::mesh::{ElectrodeShape, Outline, PrismSpec, SheetSpec, SlabSpec};

const DISC: Outline = Outline::Disc { radius_m: 0.1 };

fn disc() -> Mesh {
    SheetSpec::new(DISC, vec![], 0.012).build(&[1.0]).unwrap().0.mesh
}

fn disc_map(pixels: usize) -> (Mesh, PixelMap) {
    let (low, high) = DISC.bounds_m();
    let mesh = disc();
    let map = PixelMap::new(PixelGrid::covering(low, high, pixels).unwrap(), &mesh).unwrap();
    (mesh, map)
}

#[test]
fn grids_cover_and_count_from_the_top_left() {
    let grid = PixelGrid::covering([-0.1, -0.1], [0.1, 0.1], 40).unwrap();
    assert_eq!((grid.columns, grid.rows), (40, 40));
    assert!((grid.pixel_m - 0.005).abs() < 1e-18 && grid.left_m == -0.1 && (grid.top_m - 0.1).abs() < 1e-16);
    let [x, y] = grid.centre_m(0);
    assert!((x + 0.0975).abs() < 1e-15 && (y - 0.0975).abs() < 1e-15, "{x} {y}");
    assert_eq!(grid.pixel_at([0.0976, 0.0976]), Some(39));
    assert_eq!(grid.pixel_at([-0.0976, -0.0976]), Some(39 * 40));
    assert_eq!(grid.pixel_at([0.11, 0.0]), None);
    for (index, centre) in grid.centres_m().into_iter().enumerate() {
        assert_eq!(grid.pixel_at(centre), Some(index));
    }
    let wide = PixelGrid::covering([0.0, 0.0], [0.3, 0.1], 10).unwrap();
    assert_eq!((wide.columns, wide.rows), (10, 4));
    assert!((wide.top_m - 0.11).abs() < 1e-15, "the spare pixel is shared between top and bottom");
    assert!(PixelGrid::covering([0.0, 0.0], [0.0, 1.0], 10).is_err());
    assert!(PixelGrid::covering([0.0, 0.0], [f64::NAN, 1.0], 10).is_err());
    assert!(PixelGrid::covering([0.0, 0.0], [1.0, 1.0], 0).is_err());
}

/// Raw overlaps must add up to each element's area and to each pixel's contents.
#[test]
fn raw_overlaps_add_up_to_elements() {
    let mesh = disc();
    for pixels in [1, 7, 64] {
        let grid = PixelGrid::covering([-0.1, -0.1], [0.1, 0.1], pixels).unwrap();
        let overlaps = raw_overlaps(&grid, &mesh);
        for element in 0..mesh.element_count() {
            let range = overlaps.starts[element]..overlaps.starts[element + 1];
            let area: f64 = overlaps.shadow[range].iter().sum();
            assert!((area / mesh.measures()[element] - 1.0).abs() < 1e-12, "{area}");
        }
        let total: f64 = coverage(&grid, &mesh, &overlaps).iter().sum::<f64>() * grid.pixel_m * grid.pixel_m;
        assert!((total / mesh.measures().iter().sum::<f64>() - 1.0).abs() < 1e-12);
    }
}

/// A low-discrepancy sequence of the unit cube (additive recurrence with the plastic number's powers).
fn scattered(count: usize) -> impl Iterator<Item = [f64; 3]> {
    const STEP: [f64; 3] = [0.819_172_513_396_164_4, 0.671_043_606_703_789_2, 0.549_700_477_901_970_3];
    (0..count).map(|k| STEP.map(|step| (0.5 + step * k as f64).fract()))
}

#[test]
fn overlaps_agree_with_sampling() {
    let mesh = disc();
    let grid = PixelGrid::covering([-0.1, -0.1], [0.1, 0.1], 24).unwrap();
    let overlaps = raw_overlaps(&grid, &mesh);
    for element in (0..mesh.element_count()).step_by(37) {
        let corners = [0, 1, 2].map(|k| mesh.nodes()[mesh.element(element)[k] as usize]);
        let mut counts = std::collections::HashMap::new();
        for k in 0..20_000 {
            // The corresponding sequence for the plane: powers of the root of x^3 = x + 1.
            let [a, b] = [0.754_877_666_246_692_7, 0.569_840_290_998_053_3].map(|s: f64| (0.5 + s * k as f64).fract());
            let (u, v) = if a + b > 1.0 { (1.0 - a, 1.0 - b) } else { (a, b) };
            let at = |axis: usize| {
                corners[0][axis] + u * (corners[1][axis] - corners[0][axis]) + v * (corners[2][axis] - corners[0][axis])
            };
            *counts.entry(grid.pixel_at([at(0), at(1)]).unwrap() as u32).or_insert(0.0) += 1.0 / 20_000.0;
        }
        for &(pixel, share) in &overlaps.shares[overlaps.starts[element]..overlaps.starts[element + 1]] {
            let sampled = counts.remove(&pixel).unwrap_or(0.0);
            // The error of 20,000 quasi-random samples is a few tenths of a percent.
            assert!((sampled - share).abs() < 0.005, "element {element}, pixel {pixel}: {sampled} against {share}");
        }
        assert!(counts.values().all(|&share| share < 0.005), "sampling found pixels without overlap: {counts:?}");
    }
}

#[test]
fn volumes_agree_with_sampling_and_add_up() {
    let mesh = SlabSpec { size_m: [0.1, 0.1, 0.03], cells: [5, 5, 2], electrodes: vec![] }.build(&[1.0]).unwrap().mesh;
    let grid = PixelGrid::covering([-0.05, -0.05], [0.05, 0.05], 13).unwrap();
    let overlaps = raw_overlaps(&grid, &mesh);
    for element in 0..mesh.element_count() {
        let range = overlaps.starts[element]..overlaps.starts[element + 1];
        let whole: f64 = overlaps.shadow[range.clone()].iter().sum();
        assert!((whole / mesh.measures()[element] - 1.0).abs() < 1e-12, "{whole}");
        if element % 41 != 0 {
            continue;
        }
        let corners = [0, 1, 2, 3].map(|k| mesh.nodes()[mesh.element(element)[k] as usize]);
        let mut counts = std::collections::HashMap::new();
        for samples in scattered(20_000) {
            // Spacings of sorted uniform numbers are uniform barycentric coordinates.
            let mut s = samples;
            s.sort_by(f64::total_cmp);
            let weights = [s[0], s[1] - s[0], s[2] - s[1], 1.0 - s[2]];
            let at = |axis: usize| (0..4).map(|k| weights[k] * corners[k][axis]).sum::<f64>();
            *counts.entry(grid.pixel_at([at(0), at(1)]).unwrap() as u32).or_insert(0.0) += 1.0 / 20_000.0;
        }
        for &(pixel, share) in &overlaps.shares[range] {
            let sampled: f64 = counts.get(&pixel).copied().unwrap_or(0.0);
            assert!((sampled - share).abs() < 0.01, "element {element}, pixel {pixel}: {sampled} against {share}");
        }
    }
    let map = PixelMap::new(grid, &mesh).unwrap();
    assert!(map.coverage().iter().all(|share| (share - 1.0).abs() < 1e-12), "a slab covers every column");
    let cylinder = PrismSpec::cylinder(0.05, 0.02, 0.01, 2, vec![]).build(&[1.0]).unwrap().mesh;
    let map = PixelMap::new(grid, &cylinder).unwrap();
    let volume: f64 = map.pixel_measures().iter().sum();
    assert!((volume / cylinder.measures().iter().sum::<f64>() - 1.0).abs() < 1e-12);
    assert!((map.coverage()[6 * 13 + 6] - 1.0).abs() < 1e-12 && map.coverage()[0] == 0.0);
}

#[test]
fn weights_sum_to_one_and_slivers_are_handed_over() {
    let (mesh, map) = disc_map(40);
    for element in 0..mesh.element_count() {
        let sum: f64 = map.overlaps_of_element(element).map(|(_, weight)| weight).sum();
        assert!((sum - 1.0).abs() < 1e-12, "{sum}");
    }
    let measures: f64 = map.pixel_measures().iter().sum();
    assert!((measures / mesh.measures().iter().sum::<f64>() - 1.0).abs() < 1e-12);
    let mask = map.inside_mask();
    assert_eq!(mask.iter().filter(|inside| **inside).count(), map.inside_count());
    assert!(!mask[0] && mask[20 * 40 + 20]);
    let slivers = map.coverage().iter().filter(|share| **share > 0.0 && **share < INSIDE_COVERAGE).count();
    assert!(slivers > 0, "the test needs a sliver");
    // A grid smaller than the sheet: everything outside is assigned to its border.
    let small = PixelGrid::covering([-0.03, -0.03], [0.03, 0.03], 6).unwrap();
    let map = PixelMap::new(small, &mesh).unwrap();
    assert_eq!(map.inside_count(), 36);
    let far = (0..mesh.element_count()).find(|&k| mesh.centroid(k)[0] > 0.09).unwrap();
    let (pixel, weight) = map.overlaps_of_element(far).next().unwrap();
    assert!((weight - 1.0).abs() < 1e-12 && map.inside_centres_m()[pixel][0] > 0.02);
}

#[test]
fn values_travel_both_ways() {
    let (mesh, map) = disc_map(30);
    let ones = vec![1.0; mesh.element_count()];
    let image = map.to_pixels(&ones).unwrap();
    for (value, inside) in image.iter().zip(map.inside_mask()) {
        assert!(if inside { (value - 1.0).abs() < 1e-12 } else { value.is_nan() }, "{value}");
    }
    // A linear field: pixels deep inside have its value at their centre, up to the size of the elements.
    let slope: Vec<f64> = (0..mesh.element_count()).map(|k| mesh.centroid(k)[0] + 2.0 * mesh.centroid(k)[1]).collect();
    let image = map.to_pixels(&slope).unwrap();
    for index in 0..map.grid().len() {
        let [x, y] = map.grid().centre_m(index);
        if x.hypot(y) < 0.08 {
            assert!((image[index] - x - 2.0 * y).abs() < 0.012, "{} at {x}, {y}", image[index]);
        }
    }
    let back = map.to_elements(&map.to_inside(&slope).unwrap()).unwrap();
    let mean = |values: &[f64]| values.iter().zip(mesh.measures()).map(|(v, m)| v * m).sum::<f64>();
    assert!((mean(&back) - mean(&slope)).abs() < 1e-15, "the integral is kept");
    assert!(map.to_pixels(&[1.0]).is_err() && map.to_elements(&[1.0]).is_err() && map.image(&[]).is_err());
}

#[test]
fn a_bent_sheet_casts_its_shadow() {
    let outline = Outline::Rectangle { width_m: 0.1, height_m: 0.05 };
    let electrode = ElectrodeShape::RimSegment { centre_m: 0.05, width_m: 0.01 };
    let (flat, _) = SheetSpec::new(outline, vec![electrode], 0.004).build(&[0.1]).unwrap();
    let bent = flat.bent_onto_cylinder(0.04).unwrap();
    let map = PixelMap::new(PixelGrid::over_mesh(&bent.mesh, 40).unwrap(), &bent.mesh).unwrap();
    let measures: f64 = map.pixel_measures().iter().sum();
    assert!((measures / bent.mesh.measures().iter().sum::<f64>() - 1.0).abs() < 1e-12);
    // Bending preserves areas except for the chords: (h / R)^2 / 24 of each, 4 mm on 40 mm.
    assert!((measures / 0.005 - 1.0).abs() < 1e-3, "{measures}");
    assert!(flat.bent_onto_cylinder(0.01).is_err(), "0.1 m does not fit round a radius of 0.01 m");
}

#[test]
fn the_nearest_inside_pixel_agrees_with_a_full_search() {
    for pixels in [1, 2, 5, 24] {
        let (_, map) = disc_map(pixels);
        for k in 0..400 {
            let angle = 0.7 * f64::from(k);
            // On the disc, around it, and off the grid on every side.
            let p = [0.0005 * f64::from(k) * angle.cos(), 0.0005 * f64::from(k) * angle.sin()];
            let gap = |k: &usize| plane::distance(map.grid.centre_m(map.inside[*k] as usize), p);
            let expected = (0..map.inside.len()).min_by(|a, b| gap(a).total_cmp(&gap(b))).unwrap();
            assert_eq!(map.nearest_inside(p) as usize, expected, "{pixels} pixels, {p:?}");
        }
    }
}
