//! The law of the contact between sheet and plates.

/// Contact below this share of the saturated contact is left out, and contact above `FULL` times as much is complete.
/// The faint edge of a press covers many cells and carries little current.
const FAINT: f64 = 0.01;
const FULL: f64 = 3.0;

/// Conductance of the contact between sheet and plates: `g_max x / (1 + x)` with `x = ((p - p_t) / p_ref)^n` above the
/// threshold `p_t`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlateLaw {
    /// p_t: pressure that closes the gap, pascal.
    pub threshold_pa: f64,
    /// p_ref: pressure above the threshold at half the saturated conductance, pascal.
    pub reference_pa: f64,
    /// n.
    pub exponent: f64,
    /// g_max, S/m^2.
    pub saturation_s_per_m2: f64,
    /// s: standard deviation of the Gaussian by which pressure spreads on its way to the gap, metres.
    pub spread_m: f64,
}

impl PlateLaw {
    /// Conductance per area over the saturated one at `(p - p_t) / p_ref`, and its derivative.
    fn share(&self, relative: f64) -> [f64; 2] {
        let x = relative.powf(self.exponent);
        let share = 1.0 / (1.0 + 1.0 / x);
        [share, share * self.exponent / (relative * (1.0 + x))]
    }
}

/// Mantissa bits that number the knots within an octave. Cubics between 32 knots per octave are off by at most 4e-8 of
/// the saturated contact for exponents up to 3, and by 4e-6 for the largest that files may have, 10.
const KNOT_BITS: u32 = 5;
/// Octaves of the table above the faint contact. Beyond it, the law itself is evaluated.
const OCTAVES: i32 = 24;

/// A law with a table of it: fits evaluate it at every point under a press, and a power takes the longest of all they
/// do there.
#[derive(Clone, Debug)]
pub(super) struct Conductance {
    law: PlateLaw,
    /// 1 / p_ref.
    per_reference: f64,
    /// Pressure at which contact begins, pascal.
    faint_pa: f64,
    /// Number of the first knot.
    first: u64,
    /// The cubic from each knot to the next.
    cubics: Vec<Cubic>,
}

/// Hermite's cubic between two knots: `a + b t + c t^2 + d t^3` with `t = (x - from) / width`.
#[derive(Clone, Copy, Debug)]
struct Cubic {
    from: f64,
    /// 1 / width.
    steepness: f64,
    coefficients: [f64; 4],
}

impl Cubic {
    fn between(law: &PlateLaw, number: u64) -> Self {
        let (from, to) = (at_knot(number), at_knot(number + 1));
        let (width, [low, low_slope], [high, high_slope]) = (to - from, law.share(from), law.share(to));
        let coefficients = hermite([low, width * low_slope], [high, width * high_slope]);
        Self { from, steepness: width.recip(), coefficients }
    }

    /// Value and derivative.
    fn at(&self, x: f64) -> [f64; 2] {
        let [value, slope] = cubic_at(&self.coefficients, (x - self.from) * self.steepness);
        [value, slope * self.steepness]
    }
}

/// Coefficients `a + b t + c t^2 + d t^3` of Hermite's cubic between two knots, at t = 0 and 1, from the value and the
/// derivative by t at each.
pub(super) fn hermite([low, a]: [f64; 2], [high, b]: [f64; 2]) -> [f64; 4] {
    let rise = high - low;
    [low, a, 3.0 * rise - 2.0 * a - b, a + b - 2.0 * rise]
}

/// Value of a cubic, and its derivative by t.
#[inline]
pub(super) fn cubic_at([a, b, c, d]: &[f64; 4], t: f64) -> [f64; 2] {
    [a + t * (b + t * (c + t * d)), b + t * (2.0 * c + 3.0 * t * d)]
}

/// The number of the last knot at or below a positive value.
fn knot(relative: f64) -> u64 {
    relative.to_bits() >> (f64::MANTISSA_DIGITS - 1 - KNOT_BITS)
}

/// The value at a knot.
fn at_knot(number: u64) -> f64 {
    f64::from_bits(number << (f64::MANTISSA_DIGITS - 1 - KNOT_BITS))
}

impl Conductance {
    pub fn new(law: PlateLaw) -> Self {
        // Below this value, contact is left out.
        let least = (FAINT / (1.0 - FAINT)).powf(law.exponent.recip());
        let (first, last) = (knot(least), knot(least * 2f64.powi(OCTAVES)));
        let faint_pa = law.threshold_pa + least * law.reference_pa;
        Self {
            law,
            per_reference: law.reference_pa.recip(),
            faint_pa,
            first,
            cubics: (first..=last).map(|number| Cubic::between(&law, number)).collect(),
        }
    }

    pub fn law(&self) -> &PlateLaw {
        &self.law
    }

    /// Pressure up to which there is no contact, pascal.
    pub fn faint_pa(&self) -> f64 {
        self.faint_pa
    }

    /// As [`PlateLaw::share`], by cubics between the knots; 0 below the faint contact.
    fn share(&self, relative: f64) -> [f64; 2] {
        match knot(relative).checked_sub(self.first).map(|at| self.cubics.get(at as usize)) {
            None => [0.0; 2],
            Some(Some(cubic)) => cubic.at(relative),
            Some(None) => self.law.share(relative),
        }
    }

    /// Conductance per area (S/m^2) and its derivative with respect to the pressure.
    pub fn at(&self, pressure_pa: f64) -> [f64; 2] {
        let PlateLaw { threshold_pa, saturation_s_per_m2, .. } = self.law;
        let above = pressure_pa - threshold_pa;
        if above <= 0.0 {
            return [0.0; 2];
        }
        let [share, by_relative] = self.share(above * self.per_reference);
        let by_pressure = by_relative * self.per_reference;
        let [g, slope] = [share, by_pressure].map(|value| saturation_s_per_m2 * value);
        // The smooth step t^2 (3 - 2 t) from the faint contact on.
        match (share / FAINT - 1.0) / (FULL - 1.0) {
            t if t <= 0.0 => [0.0; 2],
            t if t >= 1.0 => [g, slope],
            t => {
                let (step, steep) = (t * t * (3.0 - 2.0 * t), 6.0 * t * (1.0 - t) / (FAINT * (FULL - 1.0)));
                [g * step, slope * (step + share * steep)]
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_is_the_law() {
        // Largest errors of value and slope: h^4 / 384 and h^3 / 72 sqrt(3) times the fourth derivative.
        for (exponent, most, most_slope) in [
            (0.1, 1e-9, 1e-7),
            (0.4, 4e-8, 4e-6),
            (1.0, 4e-8, 4e-6),
            (1.7, 4e-8, 4e-6),
            (3.0, 4e-8, 4e-6),
            (10.0, 4e-6, 4e-4),
        ] {
            let law =
                PlateLaw { threshold_pa: 2e3, reference_pa: 9e3, exponent, saturation_s_per_m2: 50.0, spread_m: 1e-3 };
            let table = Conductance::new(law);
            for k in 0..4000 {
                let relative = 1e-6 * 1.01_f64.powi(k);
                let [share, slope] = law.share(relative);
                let [near, near_slope] = table.share(relative);
                if share < FAINT {
                    assert!(near < 1.05 * FAINT, "{relative}: {near}");
                    continue;
                }
                assert!((near - share).abs() < most, "{exponent}, {relative}: {near} {share}");
                let off = relative * (near_slope - slope);
                assert!(off.abs() < most_slope, "{exponent}, {relative}: {near_slope} {slope}");
            }
        }
    }
}
