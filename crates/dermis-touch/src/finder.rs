//! Finds the contacts in an image: peaks above the noise, split at their saddles, each measured above half its
//! height.

use crate::cells::{Bounds, GridLattice, ImageCells, Lattice, SurfaceLattice};
use crate::contact::{CentroidWeight, Contact, ContactParams, ContactSign, ContactSigns, ContactStrength, PixelNoise};
use crate::error::{TouchError, require_length};
use crate::moments::CorrelatedSum;
use crate::plane::distance;
use crate::watershed::{MergeRule, Watershed, largest_of, largest_with_noise};
use std::sync::Arc;

/// Finds the contacts of images on one set of cells. Owns its working memory.
#[derive(Debug, Clone)]
pub struct ContactFinder {
    cells: ImageCells,
    finder: Finder,
}

/// The finder, compiled separately for each kind of cells.
#[derive(Debug, Clone)]
enum Finder {
    Grid(FinderOn<GridLattice>),
    Surface(FinderOn<SurfaceLattice>),
}

impl ContactFinder {
    /// A finder for images on these cells.
    ///
    /// # Errors
    /// [`TouchError::Parameter`] when the cells or a parameter are out of range.
    pub fn new(cells: impl Into<ImageCells>, params: ContactParams) -> Result<Self, TouchError> {
        let cells = cells.into();
        cells.validate()?;
        params.validate()?;
        let finder = match &cells {
            ImageCells::Grid(grid) => Finder::Grid(FinderOn::new(GridLattice::new(*grid), params)),
            ImageCells::Surface(surface) => {
                Finder::Surface(FinderOn::new(SurfaceLattice::new(Arc::clone(surface)), params))
            }
        };
        Ok(Self { cells, finder })
    }

    /// The cells of the images.
    #[must_use]
    pub fn cells(&self) -> &ImageCells {
        &self.cells
    }

    /// The thresholds and rules.
    #[must_use]
    pub fn params(&self) -> &ContactParams {
        match &self.finder {
            Finder::Grid(finder) => &finder.params,
            Finder::Surface(finder) => &finder.params,
        }
    }

    /// Replaces `contacts` by the contacts of one image, largest amplitude first.
    ///
    /// Cells with a non-finite value are outside the skin. Order and values depend only on the input.
    ///
    /// # Errors
    /// [`TouchError::Length`] when image or noise do not fit the cells, [`TouchError::Parameter`] for a negative or
    /// non-finite uniform noise; `contacts` is then empty.
    pub fn find(
        &mut self,
        image: &[f32],
        noise: PixelNoise<'_>,
        contacts: &mut Vec<Contact>,
    ) -> Result<(), TouchError> {
        contacts.clear();
        require_length("image", self.cells.len(), image.len())?;
        noise.validate(self.cells.len())?;
        match &mut self.finder {
            Finder::Grid(finder) => finder.find(image, noise, contacts),
            Finder::Surface(finder) => finder.find(image, noise, contacts),
        }
        Ok(())
    }
}

/// Sums over a contact's cells; lengths and areas in the lattice's units.
#[derive(Debug, Clone, Copy)]
struct Region {
    basin: u32,
    peak_slot: usize,
    peak_at: [f64; 2],
    peak: f32,
    area: f64,
    value: f64,
    weight: f64,
    /// Sums of weight times coordinates relative to the peak.
    moment: [f64; 2],
    bounds: Bounds,
}

impl Region {
    fn empty(basin: u32, peak_slot: usize, peak_at: [f64; 2], peak: f32) -> Self {
        let bounds = Bounds::around(peak_at);
        Self { basin, peak_slot, peak_at, peak, area: 0.0, value: 0.0, weight: 0.0, moment: [0.0; 2], bounds }
    }
}

/// The finder for one kind of cells.
#[derive(Debug, Clone)]
struct FinderOn<L> {
    params: ContactParams,
    watershed: Watershed<L>,
    correlated: CorrelatedSum,
    regions: Vec<Region>,
    /// Index into `regions` of every basin, `NO_REGION` for those below the threshold.
    region_of_basin: Vec<u32>,
}

const NO_REGION: u32 = u32::MAX;

impl<L: Lattice> FinderOn<L> {
    fn new(lattice: L, params: ContactParams) -> Self {
        let most_peaks = lattice.most_peaks();
        Self {
            params,
            correlated: CorrelatedSum::new(&lattice, params.correlation_length_m / lattice.unit_m()),
            watershed: Watershed::new(lattice),
            regions: Vec::with_capacity(params.max_contacts.min(most_peaks)),
            region_of_basin: Vec::with_capacity(most_peaks),
        }
    }

    fn find(&mut self, image: &[f32], noise: PixelNoise<'_>, contacts: &mut Vec<Contact>) {
        let (strongest, least_noise) = self.strongest(image, noise);
        // Values below half of the lowest acceptable peak are never examined.
        let lowest_peak = (self.params.relative_off as f32 * strongest)
            .max(self.params.k_off as f32 * least_noise)
            .max(self.params.min_amplitude as f32)
            .max(f32::MIN_POSITIVE);
        for &sign in self.params.signs.listed() {
            self.find_sign(image, noise, sign, strongest, lowest_peak, contacts);
        }
        contacts.sort_unstable_by(|a, b| b.amplitude.total_cmp(&a.amplitude).then(a.sign_order().cmp(&b.sign_order())));
        contacts.truncate(self.params.max_contacts);
    }

    /// Largest |value| among usable cells, for the signs searched, and the smallest noise of these cells.
    fn strongest(&self, image: &[f32], noise: PixelNoise<'_>) -> (f32, f32) {
        match self.params.signs {
            ContactSigns::Positive => largest_size(image, noise, |value| value),
            ContactSigns::Negative => largest_size(image, noise, |value| -value),
            ContactSigns::Both => largest_size(image, noise, f32::abs),
        }
    }

    fn find_sign(
        &mut self,
        image: &[f32],
        noise: PixelNoise<'_>,
        sign: ContactSign,
        strongest: f32,
        lowest_peak: f32,
        contacts: &mut Vec<Contact>,
    ) {
        let largest = self.watershed.load(image, noise.per_pixel(), sign.factor() as f32);
        if largest < lowest_peak {
            return;
        }
        let rule = MergeRule {
            saddle_ratio: self.params.saddle_ratio as f32,
            min_prominence_sigma: self.params.min_prominence_sigma as f32,
        };
        self.watershed.flood((0.5 * lowest_peak).max(f32::MIN_POSITIVE), rule, |cell| noise.at(cell));
        self.choose_regions(noise, strongest);
        self.measure_regions();
        for slot in 0..self.regions.len() {
            contacts.push(self.contact(slot, noise, sign, strongest));
        }
    }

    /// Keeps the peaks that reach the thresholds, and merges those that are too close together.
    fn choose_regions(&mut self, noise: PixelNoise<'_>, strongest: f32) {
        self.regions.clear();
        let least = (self.params.relative_off as f32 * strongest).max(self.params.min_amplitude as f32);
        let lattice = self.watershed.lattice();
        for (basin, peak, slot) in self.watershed.peaks() {
            let sigma = noise.at(lattice.cell(slot));
            if self.regions.len() < self.params.max_contacts
                && peak >= least
                && peak >= self.params.k_off as f32 * sigma
            {
                self.regions.push(Region::empty(basin, slot, lattice.coordinates(slot), peak));
            }
        }
        if self.params.min_separation_m > 0.0 {
            self.join_near_regions();
        }
    }

    fn join_near_regions(&mut self) {
        let reach = self.params.min_separation_m / self.watershed.lattice().unit_m();
        let mut kept = 0;
        for next in 0..self.regions.len() {
            let peak_at = self.regions[next].peak_at;
            let near = (0..kept).find(|&slot| distance(peak_at, self.regions[slot].peak_at) < reach);
            if let Some(slot) = near {
                self.watershed.absorb(self.regions[next].basin, self.regions[slot].basin);
            } else {
                self.regions[kept] = self.regions[next];
                kept += 1;
            }
        }
        self.regions.truncate(kept);
    }

    fn measure_regions(&mut self) {
        self.region_of_basin.clear();
        for (slot, region) in self.regions.iter().enumerate() {
            let basin = region.basin as usize;
            if self.region_of_basin.len() <= basin {
                self.region_of_basin.resize(basin + 1, NO_REGION);
            }
            self.region_of_basin[basin] = slot as u32;
        }
        for position in 0..self.watershed.flooded() {
            let (slot, value, basin) = self.watershed.flooded_cell(position);
            let of_basin = self.region_of_basin.get(basin as usize).copied().unwrap_or(NO_REGION);
            if of_basin == NO_REGION {
                continue;
            }
            let region = &mut self.regions[of_basin as usize];
            if value < 0.5 * region.peak {
                continue;
            }
            let lattice = self.watershed.lattice();
            let (at, area) = (lattice.coordinates(slot), lattice.area(slot));
            let weight = centroid_weight(self.params.centroid, value, region.peak) * area;
            region.area += area;
            region.value += f64::from(value) * area;
            region.weight += weight;
            region.moment[0] += weight * (at[0] - region.peak_at[0]);
            region.moment[1] += weight * (at[1] - region.peak_at[1]);
            region.bounds.include(at);
        }
    }

    fn contact(&mut self, slot: usize, noise: PixelNoise<'_>, sign: ContactSign, strongest: f32) -> Contact {
        let region = self.regions[slot];
        let [x, y] = region.peak_at;
        let sigma = noise.at(self.watershed.lattice().cell(region.peak_slot));
        let (shift, peak) = self.watershed.refined_peak(region.peak_slot);
        let centre = [x + region.moment[0] / region.weight, y + region.moment[1] / region.weight];
        let covariance_m2 = self.centroid_covariance(&region, centre, noise);
        let lattice = self.watershed.lattice();
        let unit_m2 = lattice.unit_m() * lattice.unit_m();
        let begins =
            region.peak >= self.params.k_on as f32 * sigma && region.peak >= self.params.relative_on as f32 * strongest;
        let value = sign.factor() * peak;
        Contact {
            peak_m: lattice.position_m([x + shift[0], y + shift[1]]),
            volume: region.value * unit_m2,
            covariance_m2,
            significance: f64::from(region.peak) / f64::from(sigma),
            strength: if begins { ContactStrength::Strong } else { ContactStrength::Weak },
            ..Contact::even(lattice.position_m(centre), value, region.area * unit_m2)
        }
    }

    fn centroid_covariance(&mut self, region: &Region, centre: [f64; 2], noise: PixelNoise<'_>) -> [[f64; 2]; 2] {
        let correlated = &mut self.correlated;
        correlated.start(region.bounds);
        self.watershed.for_each_within(region.bounds, 0.5 * region.peak, |lattice, slot, basin| {
            if basin == region.basin {
                let at = lattice.coordinates(slot);
                let weight = f64::from(noise.at(lattice.cell(slot))) * lattice.area(slot);
                let [x, y] = lattice.offset(centre, at);
                correlated.add(at, [x * weight, y * weight]);
            }
        });
        let weight = match self.params.centroid {
            CentroidWeight::Uniform => region.value,
            CentroidWeight::Value | CentroidWeight::Excess => region.weight,
        };
        let scale = (self.watershed.lattice().unit_m() / weight).powi(2);
        let (xx, xy, yy) = self.correlated.covariance();
        [[xx * scale, xy * scale], [xy * scale, yy * scale]]
    }
}

/// Largest |value| of a usable cell, and the smallest noise of one (0 if none is usable).
fn largest_size(image: &[f32], noise: PixelNoise<'_>, size: impl Fn(f32) -> f32) -> (f32, f32) {
    match noise {
        PixelNoise::Uniform(sigma) => (largest_of(image, size), sigma),
        PixelNoise::PerPixel(sigma) => {
            let (largest, least) = largest_with_noise(image, sigma, size);
            (largest, if least.is_finite() { least } else { 0.0 })
        }
    }
}

fn centroid_weight(kind: CentroidWeight, value: f32, peak: f32) -> f64 {
    match kind {
        CentroidWeight::Uniform => 1.0,
        CentroidWeight::Value => f64::from(value),
        CentroidWeight::Excess => f64::from(value) - 0.5 * f64::from(peak),
    }
}
