//! Contacts and damage on the cells of an irregular triangle mesh agree with those on a grid.

mod common;

use common::{Bell, Noise, bell, distance_mm, square};
use dermis_touch::damage::{Damage, DamageFrame, DamageMonitor, DamageParams};
use dermis_touch::{Contact, ContactFinder, ContactParams, ImageCells, PixelNoise, SurfaceCells};

/// Side of the mesh's cells before nodes are moved, metres. The triangles are about as large as the grid's 2 mm
/// pixels.
const PITCH_M: f64 = 2.7e-3;

/// A square of 128 mm divided into triangles: grid nodes, each moved by up to a quarter of the pitch, and random
/// diagonals.
fn mesh() -> SurfaceCells {
    let count = (0.128 / PITCH_M) as u32;
    let mut noise = Noise::new(11);
    let mut nodes = Vec::new();
    for row in 0..=count {
        for column in 0..=count {
            let mut along = |k: u32| PITCH_M * (f64::from(k) + 0.5 * (noise.uniform() - 0.5)) - 0.064;
            nodes.push([along(column), along(row)]);
        }
    }
    let mut triangles = Vec::new();
    for row in 0..count {
        for column in 0..count {
            let a = row * (count + 1) + column;
            let (b, c, d) = (a + 1, a + count + 1, a + count + 2);
            let halves = if noise.uniform() < 0.5 { [[a, b, d], [a, d, c]] } else { [[a, b, c], [b, d, c]] };
            triangles.extend(halves);
        }
    }
    // Shuffle the cells: results must not depend on their order.
    for last in (1..triangles.len()).rev() {
        triangles.swap(last, (noise.uniform() * last as f64) as usize);
    }
    SurfaceCells::from_triangles(&nodes, &triangles).unwrap()
}

fn sampled(cells: &ImageCells, bells: &[Bell]) -> Vec<f32> {
    let at = |[x, y]: [f64; 2]| {
        let value =
            |b: &Bell| b.height * (-((x - b.x_m).powi(2) + (y - b.y_m).powi(2)) / (2.0 * b.sigma_m.powi(2))).exp();
        bells.iter().map(value).sum::<f64>() as f32
    };
    (0..cells.len()).map(|cell| at(cells.place_m(cell))).collect()
}

fn find(cells: &ImageCells, params: ContactParams, bells: &[Bell]) -> Vec<Contact> {
    let mut contacts = Vec::new();
    let mut finder = ContactFinder::new(cells.clone(), params).unwrap();
    finder.find(&sampled(cells, bells), PixelNoise::Uniform(0.01), &mut contacts).unwrap();
    contacts
}

/// Contacts of the same bells on the grid and on the mesh.
fn on_both(params: ContactParams, bells: &[Bell]) -> (Vec<Contact>, Vec<Contact>) {
    (find(&square().into(), params, bells), find(&mesh().into(), params, bells))
}

#[test]
fn a_bump_has_the_same_place_on_a_grid_and_on_a_mesh() {
    let params = ContactParams { correlation_length_m: 6e-3, ..Default::default() };
    for (x, y) in [(12.3, -20.7), (-31.1, 4.9), (0.0, 0.0), (22.2, 35.0)] {
        let (grid, surface) = on_both(params, &[bell(x, y, 8.0, 2.0)]);
        assert_eq!((grid.len(), surface.len()), (1, 1));
        let (grid, surface) = (grid[0], surface[0]);
        let truth = [x * 1e-3, y * 1e-3];
        // Cells are 2 mm: a tenth of a cell for the centroid, a quarter for the peak of the irregular neighbourhood.
        assert!(distance_mm(surface.centroid_m, truth) < 0.2, "{:?} {truth:?}", surface.centroid_m);
        assert!(distance_mm(surface.centroid_m, grid.centroid_m) < 0.2);
        assert!(distance_mm(surface.peak_m, truth) < 0.5, "{:?} {truth:?}", surface.peak_m);
        assert!((surface.amplitude - 2.0).abs() < 0.02, "{}", surface.amplitude);
        assert!((surface.area_m2 / grid.area_m2 - 1.0).abs() < 0.05, "{} {}", surface.area_m2, grid.area_m2);
        assert!((surface.volume / grid.volume - 1.0).abs() < 0.05);
        for k in 0..2 {
            // Blocks of both kinds are accurate to 10 %.
            let ratio = surface.covariance_m2[k][k] / grid.covariance_m2[k][k];
            assert!((ratio - 1.0).abs() < 0.2, "axis {k}: {ratio}");
        }
    }
}

#[test]
fn the_scatter_of_a_centroid_on_a_mesh_agrees_with_its_sigma() {
    let cells: ImageCells = mesh().into();
    let clean = sampled(&cells, &[bell(3.1, -4.3, 8.0, 1.0)]);
    let mut finder = ContactFinder::new(cells, ContactParams::default()).unwrap();
    let (mut noise, mut contacts) = (Noise::new(5), Vec::new());
    finder.find(&clean, PixelNoise::Uniform(0.02), &mut contacts).unwrap();
    let reference = contacts[0].centroid_m;
    let (mut squares, mut predicted) = (0.0, 0.0);
    for _ in 0..300 {
        let image: Vec<f32> = clean.iter().map(|value| value + 0.02 * noise.normal() as f32).collect();
        finder.find(&image, PixelNoise::Uniform(0.02), &mut contacts).unwrap();
        let [x, y] = contacts[0].centroid_m;
        squares += (x - reference[0]).powi(2) + (y - reference[1]).powi(2);
        predicted += contacts[0].covariance_m2[0][0] + contacts[0].covariance_m2[1][1];
    }
    // 300 images give the scatter to 3 % (1 sigma).
    let ratio = (squares / predicted).sqrt();
    assert!((0.88..1.15).contains(&ratio), "{ratio}");
}

#[test]
fn two_bumps_stay_two_and_close_ones_stay_one() {
    let apart = |gap_mm: f64| {
        let bells = [bell(-gap_mm / 2.0, 1.0, 8.0, 1.0), bell(gap_mm / 2.0, 1.0, 8.0, 0.9)];
        on_both(ContactParams::default(), &bells)
    };
    for gap_mm in [26.0, 40.0] {
        let (grid, surface) = apart(gap_mm);
        assert_eq!((grid.len(), surface.len()), (2, 2), "{gap_mm} mm");
        for (grid, surface) in grid.iter().zip(&surface) {
            assert!(distance_mm(grid.centroid_m, surface.centroid_m) < 0.4, "{gap_mm} mm");
        }
    }
    let (grid, surface) = apart(14.0);
    assert_eq!((grid.len(), surface.len()), (1, 1));
}

#[test]
fn neighbourhoods_are_measured_in_metres() {
    let params = ContactParams { min_separation_m: 0.03, ..Default::default() };
    let (grid, surface) = on_both(params, &[bell(-13.0, 1.0, 8.0, 1.0), bell(13.0, 1.0, 8.0, 0.9)]);
    assert_eq!((grid.len(), surface.len()), (1, 1));
}

/// The damage that a monitor finds for a permanent dip.
fn damage_on(cells: ImageCells) -> Damage {
    let image = sampled(&cells, &[bell(20.0, -15.0, 6.0, -0.3)]);
    let mut monitor = DamageMonitor::new(cells, DamageParams::default()).unwrap();
    for frame in 0..100 {
        let frame = DamageFrame {
            time_ns: frame * 40_000_000,
            image: &image,
            noise: PixelNoise::Uniform(0.002),
            touches: &[],
            loaded: false,
            known: None,
            classes: None,
        };
        monitor.process(&frame).unwrap();
    }
    assert_eq!(monitor.damages().len(), 1);
    monitor.damages()[0]
}

#[test]
fn damage_is_the_same_on_both() {
    let (grid, surface) = (damage_on(square().into()), damage_on(mesh().into()));
    assert!(grid.is_open() && surface.is_open());
    assert!(distance_mm(grid.shape.centre_m, surface.shape.centre_m) < 0.3);
    assert!((surface.volume_m2 / grid.volume_m2 - 1.0).abs() < 0.05, "{} {}", surface.volume_m2, grid.volume_m2);
    assert!((surface.share - 1.0).abs() < 1e-6);
}

#[test]
fn a_point_is_on_the_cell_next_to_it() {
    let (grid, surface): (ImageCells, ImageCells) = (square().into(), mesh().into());
    for cells in [grid, surface] {
        for cell in (0..cells.len()).step_by(97) {
            assert_eq!(cells.cell_at(cells.place_m(cell)), Some(cell));
        }
        assert_eq!(cells.cell_at([0.1, 0.0]), None);
    }
}
