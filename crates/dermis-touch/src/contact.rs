//! A contact, one place where the skin is touched in one image, and the parameters for finding contacts.
//!
//! A contact's position is the centroid of the cells above 50 % of its peak within its basin. Its covariance
//! propagates the noise of those cells through the centroid to first order. With weights w_i = v_i - peak/2 at r_i, W
//! = sum w_i, c = sum w_i r_i / W and the level peak/2 held fixed, dc/dv_i = (r_i - c) / W. Hence C = sum_ij (r_i -
//! c)(r_j - c)' sigma_i sigma_j rho_ij / W^2 with rho_ij = exp(-|r_i - r_j|^2 / (2 l^2)). If cells differ in area,
//! each is weighted by its area.

use crate::error::{TouchError, require, require_length};
use crate::force::ForceReading;
use crate::hypotheses::PlaceHypothesis;
use serde::{Deserialize, Serialize};

/// Side of the background that a contact is on.
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

/// Signs to search for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ContactSigns {
    /// Only values above zero: on a skin, pressing is positive.
    #[default]
    Positive,
    /// Only values below zero.
    Negative,
    /// Both, as in a tank with conductive and resistive objects.
    Both,
}

impl ContactSigns {
    pub(crate) fn listed(self) -> &'static [ContactSign] {
        match self {
            Self::Positive => &[ContactSign::Positive],
            Self::Negative => &[ContactSign::Negative],
            Self::Both => &[ContactSign::Positive, ContactSign::Negative],
        }
    }
}

/// Weights of the cells above half the peak in the centroid.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum CentroidWeight {
    /// Equal weights: the centroid of the region, as measured in the paper on the self-healing skin. Cells jump in or
    /// out when noise moves them across half height. [`Contact::covariance_m2`] ignores that and is only a lower
    /// bound, several times too small along each axis for white noise.
    Uniform,
    /// Weighted by value. The covariance has the same limitation.
    Value,
    /// Weighted by value minus half the peak. Cells enter and leave smoothly, so a moving touch moves smoothly, and
    /// the covariance is correct to first order.
    #[default]
    Excess,
}

/// Thresholds that a contact exceeds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ContactStrength {
    /// Above the thresholds for beginning a touch.
    Strong,
    /// Only above the thresholds for holding an existing touch.
    Weak,
}

/// Standard deviation of the image noise, in image units.
#[derive(Debug, Clone, Copy)]
pub enum PixelNoise<'a> {
    /// The same for every cell; finite, not negative. 0 means no noise, which meets every threshold in sigma.
    Uniform(f32),
    /// One value per cell, in image order. Cells with a non-finite or negative value are treated as outside the skin.
    PerPixel(&'a [f32]),
}

impl PixelNoise<'_> {
    pub(crate) fn at(&self, index: usize) -> f32 {
        match self {
            Self::Uniform(sigma) => *sigma,
            Self::PerPixel(sigma) => sigma[index],
        }
    }

    pub(crate) fn validate(&self, cells: usize) -> Result<(), TouchError> {
        match self {
            Self::Uniform(sigma) => {
                require(sigma.is_finite() && *sigma >= 0.0, "noise sigma", f64::from(*sigma), "finite and at least 0")
            }
            Self::PerPixel(sigma) => require_length("noise sigma per cell", cells, sigma.len()),
        }
    }

    /// One value per cell, or `None` if uniform.
    pub(crate) fn per_pixel(&self) -> Option<&[f32]> {
        match self {
            Self::Uniform(_) => None,
            Self::PerPixel(sigma) => Some(sigma),
        }
    }
}

/// Thresholds and rules of a [`crate::ContactFinder`].
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ContactParams {
    /// A touch begins if its peak reaches this many sigma. At least `k_off`.
    pub k_on: f64,
    /// An existing touch is held while its peak reaches this many sigma. Above 0.
    pub k_off: f64,
    /// A touch begins if its peak reaches this share of the image's strongest peak. Weaker peaks are side lobes of
    /// the reconstruction. From `relative_off` to 1.
    pub relative_on: f64,
    /// An existing touch is held while its peak reaches this share of the strongest. From 0 to 1.
    pub relative_off: f64,
    /// Minimum peak of a contact, image units. At least 0.
    pub min_amplitude: f64,
    /// Merge two peaks if the saddle between them is above this share of the lower peak. From 0.5 to 1.
    pub saddle_ratio: f64,
    /// Merge two peaks if the lower one rises less than this many sigma above the saddle. At least 0.
    pub min_prominence_sigma: f64,
    /// Merge two peaks closer than this, metres. At least 0; 0 switches the rule off.
    pub min_separation_m: f64,
    /// Correlation length l of the image noise (rho = exp(-d^2 / (2 l^2))), metres. At least 0; 0 is white noise.
    pub correlation_length_m: f64,
    /// Maximum number of contacts; the strongest of each sign are kept. At least 1.
    pub max_contacts: usize,
    /// Signs to search for.
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
    /// The peak, refined to sub-cell accuracy by a quadratic through the neighbours. At the skin's border, where a
    /// neighbour is missing, the pixel centre in that direction (on a surface, the cell's position).
    pub peak_m: [f64; 2],
    /// The image's value at `peak_m`, signed, image units. Never 0.
    pub peak_value: f64,
    /// Centroid of the cells above half the peak within the contact's basin.
    pub centroid_m: [f64; 2],
    /// Area of those cells, m^2. At least one cell.
    pub area_m2: f64,
    /// |`peak_value`|, image units. Above 0.
    pub amplitude: f64,
    /// Sum of |value| times area over those cells, image units times m^2. Divided by `area_m2` it is the mean.
    pub volume: f64,
    /// Covariance of `centroid_m`, rows and columns x, y, m^2. Zero if the noise is zero, and for a contact of one
    /// cell, whose centroid cannot move.
    pub covariance_m2: [[f64; 2]; 2],
    /// |value| of the peak cell over its noise. Infinite if the noise is zero.
    pub significance: f64,
    /// Sign of the contact.
    pub sign: ContactSign,
    /// Strength: it may begin a touch, or only hold one.
    pub strength: ContactStrength,
    /// Normal force, if a calibration has estimated one; the finder sets `None`.
    pub force: Option<ForceReading>,
    /// Radius of the spot fitted by a forward model, metres, if position and covariance come from that fit; the
    /// finder sets `None`.
    pub radius_m: Option<f64>,
    /// Variance of each coordinate of `centroid_m` due to model error, m^2, in addition to `covariance_m2`; the
    /// finder sets 0.
    pub model_variance_m2: f64,
    /// Depth or force of the press, if a calibration by pokes has estimated it; the finder sets `None`.
    pub load: Option<TouchLoad>,
    /// Another possible position, if a calibration cannot decide; the finder sets `None`.
    pub other_place: Option<PlaceHypothesis>,
    /// True if a fit found that exactly one touch explains it.
    #[serde(default)]
    pub is_single: bool,
    /// True if a search of an earlier frame found it, too. It then counts as two frames towards a touch.
    #[serde(default)]
    pub was_found: bool,
}

impl Contact {
    /// A strong contact with one value (image units, not 0) over an area (m^2) around a position, in an image without
    /// noise. No fit or calibration has been applied.
    pub fn even(position_m: [f64; 2], value: f64, area_m2: f64) -> Self {
        Self {
            peak_m: position_m,
            peak_value: value,
            centroid_m: position_m,
            area_m2,
            amplitude: value.abs(),
            volume: value.abs() * area_m2,
            covariance_m2: [[0.0; 2]; 2],
            significance: f64::INFINITY,
            sign: if value < 0.0 { ContactSign::Negative } else { ContactSign::Positive },
            strength: ContactStrength::Strong,
            force: None,
            radius_m: None,
            model_variance_m2: 0.0,
            load: None,
            other_place: None,
            is_single: false,
            was_found: false,
        }
    }

    /// Number of frames that it counts for towards a touch.
    pub(crate) fn strong_frames(&self) -> u32 {
        match self.strength {
            ContactStrength::Strong => 1 + u32::from(self.was_found),
            ContactStrength::Weak => 0,
        }
    }

    pub(crate) fn sign_order(&self) -> u8 {
        match self.sign {
            ContactSign::Positive => 0,
            ContactSign::Negative => 1,
        }
    }

    /// One of several touches that the image shows as this contact, at its own position and with a share of the
    /// strength.
    #[must_use]
    pub fn share_at(&self, position_m: [f64; 2], share: f64) -> Self {
        Self {
            peak_m: position_m,
            centroid_m: position_m,
            amplitude: share * self.amplitude,
            peak_value: share * self.peak_value,
            volume: share * self.volume,
            significance: share * self.significance,
            ..*self
        }
    }

    /// Radius of a disc with the contact's area, metres.
    #[must_use]
    pub fn radius_m(&self) -> f64 {
        (self.area_m2 / std::f64::consts::PI).sqrt()
    }
}

/// Quantity in which the load of pokes was measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LoadQuantity {
    /// Depth of indentation, metres.
    DepthM,
    /// Force, newtons.
    ForceN,
}

/// The load of a touch, in the quantity that the calibration's pokes were measured in.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TouchLoad {
    /// Depth or force.
    pub quantity: LoadQuantity,
    /// Value in metres or newtons.
    pub value: f64,
    /// Standard deviation of `value`, in its unit.
    pub sigma: f64,
}
