//! Low regions of an image: the cells connected over edges to a minimum that are below half of it, with their
//! moments. The length of a line follows from the larger second moment minus a point's: a line of length L has the
//! variance L^2/12.

use super::{DamageParams, DamageShape};
use crate::cells::ImageCells;

/// One low region.
#[derive(Debug, Clone, Copy)]
pub(super) struct Region {
    pub shape: DamageShape,
    /// Depth of its minimum.
    pub depth: f64,
    /// Noise at the minimum.
    pub sigma: f64,
    pub volume_m2: f64,
    /// Its bit in the label image.
    pub bit: u16,
}

/// Finds low regions. Owns its working memory.
#[derive(Debug, Clone)]
pub(super) struct RegionFinder {
    /// Bit of the region that each cell belongs to.
    labels: Vec<u16>,
    stack: Vec<u32>,
    regions: Vec<Region>,
    /// Cells that belong to a region or to the slope around it, and cannot start another.
    taken: Vec<bool>,
}

/// Sums over the cells of a region.
#[derive(Debug, Clone, Copy, Default)]
struct Moments {
    weight: f64,
    first: [f64; 2],
    second: [f64; 3],
    volume: f64,
}

impl Moments {
    fn add(&mut self, [x, y]: [f64; 2], value: f64, weight: f64) {
        self.volume += value;
        self.weight += weight;
        self.first[0] += weight * x;
        self.first[1] += weight * y;
        self.second[0] += weight * x * x;
        self.second[1] += weight * x * y;
        self.second[2] += weight * y * y;
    }

    fn shape(&self, point_spread_m: f64) -> DamageShape {
        let [x, y] = self.first.map(|sum| sum / self.weight);
        let [xx, xy, yy] = self.second.map(|sum| sum / self.weight);
        let (xx, xy, yy) = (xx - x * x, xy - x * y, yy - y * y);
        let (mean, half) = (0.5 * (xx + yy), (0.25 * (xx - yy).powi(2) + xy * xy).sqrt());
        let extent = |variance: f64| (12.0 * (variance - point_spread_m * point_spread_m).max(0.0)).sqrt();
        let direction = 0.5 * (2.0 * xy).atan2(xx - yy);
        DamageShape {
            centre_m: [x, y],
            length_m: extent(mean + half),
            width_m: extent(mean - half),
            direction_rad: direction,
            deviations: None,
        }
    }
}

impl RegionFinder {
    pub fn new(cells: usize, most: usize) -> Self {
        Self {
            labels: vec![0; cells],
            stack: Vec::with_capacity(cells),
            regions: Vec::with_capacity(most),
            taken: vec![false; cells],
        }
    }

    /// The regions found last, deepest first.
    pub fn regions(&self) -> &[Region] {
        &self.regions
    }

    /// Bit of the region that each cell belongs to, 0 for none.
    pub fn labels(&self) -> &[u16] {
        &self.labels
    }

    /// Finds the regions of an image. A minimum must be at least `least` deep, and exceed the parameters' multiple of
    /// `sigma(cell)` and share of the deepest minimum.
    pub fn find(
        &mut self,
        image: &[f32],
        cells: &ImageCells,
        params: &DamageParams,
        sigma: impl Fn(usize) -> f64,
        least: f64,
    ) {
        self.labels.fill(0);
        self.taken.fill(false);
        self.regions.clear();
        let mut deepest = 0.0_f64;
        while self.regions.len() < params.most.min(16) {
            let open = |(index, value): &(usize, &f32)| value.is_finite() && !self.taken[*index];
            let lowest = image.iter().enumerate().filter(open).min_by(|a, b| a.1.total_cmp(b.1));
            let Some((seed, value)) = lowest else { break };
            let depth = -f64::from(*value);
            deepest = deepest.max(depth);
            let limit = least.max(params.begin_sigma * sigma(seed)).max(params.lobe_share * deepest);
            if depth < limit {
                break;
            }
            let bit = 1 << self.regions.len();
            let moments = self.flood(image, cells, seed, bit);
            let volume_m2 = moments.volume * cells.cell_size_m() * cells.cell_size_m();
            let shape = moments.shape(params.point_spread_m);
            self.regions.push(Region { shape, depth, sigma: sigma(seed), volume_m2, bit });
        }
    }

    /// Collects the cells connected to a minimum that are below half of it, and marks the slope around them as taken.
    fn flood(&mut self, image: &[f32], cells: &ImageCells, seed: usize, bit: u16) -> Moments {
        let half = 0.5 * -image[seed];
        let mut moments = Moments::default();
        self.stack.clear();
        self.stack.push(seed as u32);
        self.taken[seed] = true;
        while let Some(index) = self.stack.pop() {
            let index = index as usize;
            let value = -image[index];
            if value >= half {
                self.labels[index] = bit;
                let (area, weight) = (cells.relative_area(index), f64::from(value - half).max(f64::MIN_POSITIVE));
                moments.add(cells.place_m(index), f64::from(value) * area, weight * area);
            }
            cells.for_each_edge_neighbour(index, |next| {
                // Spread across the region, then onwards only while the image rises towards zero.
                let lies = -image[next];
                if !self.taken[next] && lies > 0.0 && (lies >= half || lies <= value) {
                    self.taken[next] = true;
                    self.stack.push(next as u32);
                }
            });
        }
        moments
    }
}
