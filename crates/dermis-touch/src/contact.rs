//! From one image to its contacts: peaks above the noise, split by their saddles, each measured above half its height.
//!
//! A contact's position is the centroid of the pixels above 50 % of its peak within its basin; its covariance is the
//! noise of those pixels carried through the centroid to first order: with weights w_i = v_i - peak/2 at r_i, W = sum w_i,
//! c = sum w_i r_i / W and the level peak/2 held, dc/dv_i = (r_i - c) / W, hence
//! C = sum_ij (r_i - c)(r_j - c)' sigma_i sigma_j rho_ij / W^2 with rho_ij = exp(-|r_i - r_j|^2 / (2 l^2)).

use crate::error::{TouchError, require, require_length};
use crate::force::ForceReading;
use crate::geometry::ImageGeometry;
use crate::moments::{CorrelatedSum, PixelBox};
use crate::watershed::{MergeRule, Watershed, largest_of, largest_with_noise};
use serde::{Deserialize, Serialize};

/// Whether a contact rises above the background or sinks below it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ContactSign {
    /// The image is above zero: pressed, or conductive.
    Positive,
    /// The image is below zero: damaged, or resistive.
    Negative,
}

impl ContactSign {
    /// +1 or -1.
    #[must_use]
    pub fn factor(self) -> f64 {
        match self {
            Self::Positive => 1.0,
            Self::Negative => -1.0,
        }
    }
}

/// Which signs are looked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ContactSigns {
    /// Only values above zero, as on a skin, where pressing is positive.
    #[default]
    Positive,
    /// Only values below zero.
    Negative,
    /// Both, as in a tank with conductive and resistive objects.
    Both,
}

impl ContactSigns {
    fn listed(self) -> &'static [ContactSign] {
        match self {
            Self::Positive => &[ContactSign::Positive],
            Self::Negative => &[ContactSign::Negative],
            Self::Both => &[ContactSign::Positive, ContactSign::Negative],
        }
    }
}

/// How pixels above half the peak weigh in the centroid.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum CentroidWeight {
    /// All alike: the centroid of the region, as the self-healing skin's paper measures it. Pixels that noise lifts over
    /// half height, or sinks below it, enter and leave with a step; [`Contact::covariance_m2`] leaves that out and is
    /// only a lower bound, several times too small in each axis for white noise.
    Uniform,
    /// By their value. The same holds for its covariance.
    Value,
    /// By their value less half the peak: pixels enter and leave without a step, so a moving touch moves smoothly, and the
    /// covariance is right to first order.
    #[default]
    Excess,
}

/// Whether a contact is clear enough to begin a touch.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ContactStrength {
    /// Above the thresholds that begin a touch.
    Strong,
    /// Only above the thresholds that hold one that has begun.
    Weak,
}

/// The standard deviation of the image's noise, in image units.
#[derive(Debug, Clone, Copy)]
pub enum PixelNoise<'a> {
    /// The same for every pixel; finite, not negative. 0 means no noise: every threshold in sigma is then met.
    Uniform(f32),
    /// One value a pixel, row-major like the image. Pixels whose value is not finite, or negative, are left out as if
    /// they lay outside the skin.
    PerPixel(&'a [f32]),
}

impl PixelNoise<'_> {
    pub(crate) fn at(&self, index: usize) -> f32 {
        match self {
            Self::Uniform(sigma) => *sigma,
            Self::PerPixel(sigma) => sigma[index],
        }
    }

    pub(crate) fn validate(&self, pixels: usize) -> Result<(), TouchError> {
        match self {
            Self::Uniform(sigma) => {
                require(sigma.is_finite() && *sigma >= 0.0, "noise sigma", f64::from(*sigma), "finite and at least 0")
            }
            Self::PerPixel(sigma) => require_length("noise sigma per pixel", pixels, sigma.len()),
        }
    }

    /// One value a pixel, where that is so.
    fn per_pixel(&self) -> Option<&[f32]> {
        match self {
            Self::Uniform(_) => None,
            Self::PerPixel(sigma) => Some(sigma),
        }
    }
}

/// Thresholds and rules of a [`ContactFinder`].
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ContactParams {
    /// A touch begins where the peak reaches this many sigma. At least `k_off`.
    pub k_on: f64,
    /// A touch that has begun is held while its peak reaches this many sigma. Above 0.
    pub k_off: f64,
    /// A touch begins where the peak reaches this part of the image's strongest peak; below stand the side lobes of the
    /// reconstruction. From `relative_off` to 1.
    pub relative_on: f64,
    /// A touch that has begun is held while its peak reaches this part of the strongest. From 0 to 1.
    pub relative_off: f64,
    /// No contact has a smaller peak than this, image units. At least 0.
    pub min_amplitude: f64,
    /// Two peaks are one when the saddle between them is above this part of the lower peak. From 0.5 to 1.
    pub saddle_ratio: f64,
    /// Two peaks are one when the lower rises less than this many sigma above the saddle. At least 0.
    pub min_prominence_sigma: f64,
    /// Two peaks nearer than this, in metres, are one. At least 0; 0 switches the rule off.
    pub min_separation_m: f64,
    /// Length over which the image's noise is correlated (rho = exp(-d^2 / (2 l^2))), metres. At least 0; 0 is white noise.
    pub correlation_length_m: f64,
    /// At most so many contacts, the strongest of each sign. At least 1.
    pub max_contacts: usize,
    /// Signs looked for.
    pub signs: ContactSigns,
    /// Weights of the centroid.
    pub centroid: CentroidWeight,
}

impl Default for ContactParams {
    /// 5 sigma to begin, 3 to hold; 25 % and 15 % of the strongest peak; saddle at 75 %; white noise; positive only.
    fn default() -> Self {
        Self {
            k_on: 5.0,
            k_off: 3.0,
            relative_on: 0.25,
            relative_off: 0.15,
            min_amplitude: 0.0,
            saddle_ratio: 0.75,
            min_prominence_sigma: 2.0,
            min_separation_m: 0.0,
            correlation_length_m: 0.0,
            max_contacts: 32,
            signs: ContactSigns::Positive,
            centroid: CentroidWeight::Excess,
        }
    }
}

impl ContactParams {
    /// Checks every field against its range.
    ///
    /// # Errors
    /// [`TouchError::Parameter`] naming the field.
    pub fn validate(&self) -> Result<(), TouchError> {
        let finite = |x: f64| x.is_finite() && x >= 0.0;
        require(self.k_off.is_finite() && self.k_off > 0.0, "k_off", self.k_off, "finite and above 0")?;
        require(self.k_on.is_finite() && self.k_on >= self.k_off, "k_on", self.k_on, "finite and at least k_off")?;
        require((0.0..=1.0).contains(&self.relative_off), "relative_off", self.relative_off, "from 0 to 1")?;
        let on = (self.relative_off..=1.0).contains(&self.relative_on);
        require(on, "relative_on", self.relative_on, "from relative_off to 1")?;
        require(finite(self.min_amplitude), "min_amplitude", self.min_amplitude, "finite and at least 0")?;
        require((0.5..=1.0).contains(&self.saddle_ratio), "saddle_ratio", self.saddle_ratio, "from 0.5 to 1")?;
        let prominence = self.min_prominence_sigma;
        require(finite(prominence), "min_prominence_sigma", prominence, "finite and at least 0")?;
        require(finite(self.min_separation_m), "min_separation_m", self.min_separation_m, "finite and at least 0")?;
        let length = self.correlation_length_m;
        require(finite(length), "correlation_length_m", length, "finite and at least 0")?;
        require(self.max_contacts > 0, "max_contacts", self.max_contacts as f64, "at least 1")
    }
}

/// One place where the skin is touched, in one image. Positions are in the skin's frame, metres.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Contact {
    /// The peak, refined below a pixel by a quadratic through its neighbours; at the skin's border, where a neighbour is
    /// missing, the pixel's centre in that direction.
    pub peak_m: [f64; 2],
    /// The image's value at `peak_m`, signed, image units. Never 0.
    pub peak_value: f64,
    /// Centroid of the pixels above half the peak within the contact's basin.
    pub centroid_m: [f64; 2],
    /// Area of those pixels, m^2. At least one pixel's.
    pub area_m2: f64,
    /// |`peak_value`|, image units. Above 0.
    pub amplitude: f64,
    /// Sum of |value| over those pixels times a pixel's area, image units times m^2; over `area_m2` it is the mean.
    pub volume: f64,
    /// Covariance of `centroid_m`, rows and columns x, y, m^2. Zero when the noise is zero, and for a contact of one
    /// pixel, whose centroid cannot move.
    pub covariance_m2: [[f64; 2]; 2],
    /// The peak pixel's |value| over its noise. Infinite when the noise is zero.
    pub significance: f64,
    /// Above or below the background.
    pub sign: ContactSign,
    /// Whether it may begin a touch or only hold one.
    pub strength: ContactStrength,
    /// Normal force, where a calibration has read one; the finder has none.
    pub force: Option<ForceReading>,
    /// Radius of the spot that a forward model fitted, metres, where position and covariance are that fit's; the finder has
    /// none.
    pub radius_m: Option<f64>,
}

/// What is summed over a contact's pixels; positions in pixels from the peak.
#[derive(Debug, Clone, Copy)]
struct Region {
    basin: u32,
    peak_pixel: usize,
    peak: f32,
    pixels: usize,
    value: f64,
    weight: f64,
    /// Sums of weight times (column, row).
    moment: [f64; 2],
    bounds: PixelBox,
}

impl Region {
    fn empty(basin: u32, peak_pixel: usize, peak: f32, bounds: PixelBox) -> Self {
        Self { basin, peak_pixel, peak, pixels: 0, value: 0.0, weight: 0.0, moment: [0.0; 2], bounds }
    }
}

/// Finds the contacts of images on one grid, in memory of its own.
#[derive(Debug, Clone)]
pub struct ContactFinder {
    geometry: ImageGeometry,
    params: ContactParams,
    watershed: Watershed,
    correlated: CorrelatedSum,
    regions: Vec<Region>,
    /// Slot in `regions` of every basin, `NO_REGION` for those below the threshold.
    region_of_basin: Vec<u32>,
}

const NO_REGION: u32 = u32::MAX;

impl ContactFinder {
    /// A finder for images on `geometry`.
    ///
    /// # Errors
    /// [`TouchError::Parameter`] when the geometry or a parameter is out of range.
    pub fn new(geometry: ImageGeometry, params: ContactParams) -> Result<Self, TouchError> {
        geometry.validate()?;
        params.validate()?;
        let correlation_pixels = params.correlation_length_m / geometry.pixel_m;
        // No two peaks are neighbours.
        let most_peaks = geometry.columns.div_ceil(2) * geometry.rows.div_ceil(2);
        Ok(Self {
            geometry,
            params,
            watershed: Watershed::new(geometry.columns, geometry.rows),
            correlated: CorrelatedSum::new(geometry.columns, geometry.rows, correlation_pixels),
            regions: Vec::with_capacity(params.max_contacts.min(most_peaks)),
            region_of_basin: Vec::with_capacity(most_peaks),
        })
    }

    /// The grid of the images.
    #[must_use]
    pub fn geometry(&self) -> &ImageGeometry {
        &self.geometry
    }

    /// The thresholds and rules.
    #[must_use]
    pub fn params(&self) -> &ContactParams {
        &self.params
    }

    /// Replaces `contacts` by the contacts of one image, from the largest amplitude down.
    ///
    /// Pixels that are not finite lie outside the skin. The order and the values depend on nothing but the input.
    ///
    /// # Errors
    /// [`TouchError::Length`] when image or noise do not fit the grid, [`TouchError::Parameter`] for a negative or
    /// non-finite uniform noise; `contacts` is then empty.
    pub fn find(
        &mut self,
        image: &[f32],
        noise: PixelNoise<'_>,
        contacts: &mut Vec<Contact>,
    ) -> Result<(), TouchError> {
        contacts.clear();
        require_length("image", self.geometry.len(), image.len())?;
        noise.validate(self.geometry.len())?;
        let (strongest, least_noise) = self.strongest(image, noise);
        // Nothing below half of the smallest peak that can count is ever looked at.
        let lowest_peak = (self.params.relative_off as f32 * strongest)
            .max(self.params.k_off as f32 * least_noise)
            .max(self.params.min_amplitude as f32)
            .max(f32::MIN_POSITIVE);
        for &sign in self.params.signs.listed() {
            self.find_sign(image, noise, sign, strongest, lowest_peak, contacts);
        }
        contacts.sort_unstable_by(|a, b| b.amplitude.total_cmp(&a.amplitude).then(a.sign_order().cmp(&b.sign_order())));
        contacts.truncate(self.params.max_contacts);
        Ok(())
    }

    /// The largest |value| of the signs looked for among usable pixels, and their smallest noise.
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
        self.watershed.flood((0.5 * lowest_peak).max(f32::MIN_POSITIVE), rule, |index| noise.at(index));
        self.choose_regions(noise, strongest);
        self.measure_regions();
        for slot in 0..self.regions.len() {
            contacts.push(self.contact(slot, noise, sign, strongest));
        }
    }

    /// Keeps the standing peaks that reach the thresholds, and joins those that stand too near.
    fn choose_regions(&mut self, noise: PixelNoise<'_>, strongest: f32) {
        self.regions.clear();
        let least = (self.params.relative_off as f32 * strongest).max(self.params.min_amplitude as f32);
        for (basin, peak, pixel) in self.watershed.peaks() {
            let sigma = noise.at(self.watershed.image_index(pixel));
            if self.regions.len() < self.params.max_contacts
                && peak >= least
                && peak >= self.params.k_off as f32 * sigma
            {
                let (column, row) = self.watershed.column_row(pixel);
                self.regions.push(Region::empty(basin, pixel, peak, PixelBox::around(column, row)));
            }
        }
        if self.params.min_separation_m > 0.0 {
            self.join_near_regions();
        }
    }

    fn join_near_regions(&mut self) {
        let reach = self.params.min_separation_m / self.geometry.pixel_m;
        let mut kept = 0;
        for next in 0..self.regions.len() {
            let (column, row) = self.watershed.column_row(self.regions[next].peak_pixel);
            let near = (0..kept).find(|&slot| {
                let (other_column, other_row) = self.watershed.column_row(self.regions[slot].peak_pixel);
                (column as f64 - other_column as f64).hypot(row as f64 - other_row as f64) < reach
            });
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
            let (pixel, value, basin) = self.watershed.flooded_pixel(position);
            let slot = self.region_of_basin.get(basin as usize).copied().unwrap_or(NO_REGION);
            if slot == NO_REGION {
                continue;
            }
            let (column, row) = self.watershed.column_row(pixel);
            let region = &mut self.regions[slot as usize];
            if value < 0.5 * region.peak {
                continue;
            }
            let weight = centroid_weight(self.params.centroid, value, region.peak);
            let (peak_column, peak_row) = self.watershed.column_row(region.peak_pixel);
            region.pixels += 1;
            region.value += f64::from(value);
            region.weight += weight;
            region.moment[0] += weight * (column as f64 - peak_column as f64);
            region.moment[1] += weight * (row as f64 - peak_row as f64);
            region.bounds.include(column, row);
        }
    }

    fn contact(&mut self, slot: usize, noise: PixelNoise<'_>, sign: ContactSign, strongest: f32) -> Contact {
        let region = self.regions[slot];
        let (column, row) = self.watershed.column_row(region.peak_pixel);
        let (column, row) = (column as f64, row as f64);
        let sigma = noise.at(self.watershed.image_index(region.peak_pixel));
        let (shift, peak) = self.refine_peak(region.peak_pixel);
        let centre = [column + region.moment[0] / region.weight, row + region.moment[1] / region.weight];
        let pixel_area = self.geometry.pixel_m * self.geometry.pixel_m;
        let begins =
            region.peak >= self.params.k_on as f32 * sigma && region.peak >= self.params.relative_on as f32 * strongest;
        Contact {
            peak_m: self.geometry.position_m(column + shift[0], row + shift[1]),
            peak_value: sign.factor() * peak,
            centroid_m: self.geometry.position_m(centre[0], centre[1]),
            area_m2: region.pixels as f64 * pixel_area,
            amplitude: peak,
            volume: region.value * pixel_area,
            covariance_m2: self.centroid_covariance(&region, centre, noise),
            significance: f64::from(region.peak) / f64::from(sigma),
            sign,
            strength: if begins { ContactStrength::Strong } else { ContactStrength::Weak },
            force: None,
            radius_m: None,
        }
    }

    /// Offset in pixels (column, row) and height of the quadratic through the peak and its eight neighbours.
    fn refine_peak(&self, pixel: usize) -> ([f64; 2], f64) {
        let stride = self.watershed.stride();
        let at = |index: usize| f64::from(self.watershed.value(index));
        let top = at(pixel);
        let axis = |less: f64, more: f64| {
            let (slope, bend) = (0.5 * (more - less), more - 2.0 * top + less);
            // NaN neighbours compare false.
            if bend < 0.0 { (slope, bend) } else { (0.0, -1.0) }
        };
        let (slope_x, bend_x) = axis(at(pixel - 1), at(pixel + 1));
        let (slope_y, bend_y) = axis(at(pixel - stride), at(pixel + stride));
        let twist =
            0.25 * (at(pixel + stride + 1) - at(pixel + stride - 1) - at(pixel - stride + 1) + at(pixel - stride - 1));
        let determinant = bend_x * bend_y - twist * twist;
        // A saddle-like or one-sided neighbourhood is fitted along the axes only.
        let (twist, determinant) = if determinant > 0.1 * bend_x * bend_y && slope_x != 0.0 && slope_y != 0.0 {
            (twist, determinant)
        } else {
            (0.0, bend_x * bend_y)
        };
        let dx = ((twist * slope_y - bend_y * slope_x) / determinant).clamp(-0.5, 0.5);
        let dy = ((twist * slope_x - bend_x * slope_y) / determinant).clamp(-0.5, 0.5);
        let height = top + 0.5 * (slope_x * dx + slope_y * dy);
        ([dx, dy], height.max(top))
    }

    fn centroid_covariance(&mut self, region: &Region, centre: [f64; 2], noise: PixelNoise<'_>) -> [[f64; 2]; 2] {
        self.correlated.start(region.bounds);
        for row in region.bounds.first.1..=region.bounds.last.1 {
            for column in region.bounds.first.0..=region.bounds.last.0 {
                let pixel = self.watershed.padded(column, row);
                if self.watershed.value(pixel) >= 0.5 * region.peak
                    && self.watershed.basin_of(pixel) == Some(region.basin)
                {
                    let sigma = f64::from(noise.at(row * self.geometry.columns + column));
                    // Rows count downwards, y upwards.
                    let vector = [(column as f64 - centre[0]) * sigma, (centre[1] - row as f64) * sigma];
                    self.correlated.add(column, row, vector);
                }
            }
        }
        let weight = match self.params.centroid {
            CentroidWeight::Uniform => region.value,
            CentroidWeight::Value | CentroidWeight::Excess => region.weight,
        };
        let scale = (self.geometry.pixel_m / weight).powi(2);
        let (xx, xy, yy) = self.correlated.covariance();
        [[xx * scale, xy * scale], [xy * scale, yy * scale]]
    }
}

impl Contact {
    fn sign_order(&self) -> u8 {
        match self.sign {
            ContactSign::Positive => 0,
            ContactSign::Negative => 1,
        }
    }

    /// Radius of the disc of the contact's area, metres.
    #[must_use]
    pub fn radius_m(&self) -> f64 {
        (self.area_m2 / std::f64::consts::PI).sqrt()
    }
}

/// The largest size of a usable pixel, and the smallest noise of one (0 when none is usable).
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
