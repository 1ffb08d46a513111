//! Round steps along axes, and their labels.

/// One axis: maps data from `low` to `high` onto pixels from `start` to `end`.
pub struct Axis {
    pub low: f64,
    pub high: f64,
    pub start: f64,
    pub end: f64,
    /// Distance between two ticks.
    pub step: f64,
}

impl Axis {
    /// An axis that covers the values, extended to whole steps, with about `ticks` ticks.
    pub fn over(values: impl Iterator<Item = f64>, [start, end]: [f64; 2], ticks: usize) -> Self {
        let (mut low, mut high) =
            values.filter(|v| v.is_finite()).fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
        if low > high {
            (low, high) = (0.0, 1.0);
        }
        if low == high {
            let room = if low == 0.0 { 1.0 } else { 0.5 * low.abs() };
            (low, high) = (low - room, high + room);
        }
        let step = nice_at_least((high - low) / ticks as f64);
        // Ignore rounding errors: a value that is nearly a whole step doesn't need another step.
        let (low, high) = ((low / step + 1e-9).floor() * step, (high / step - 1e-9).ceil() * step);
        Self { low, high, start, end, step }
    }

    /// Pixel of a value.
    pub fn place(&self, value: f64) -> f64 {
        self.start + (value - self.low) / (self.high - self.low) * (self.end - self.start)
    }

    /// Values of the ticks.
    pub fn ticks(&self) -> impl Iterator<Item = f64> + '_ {
        let count = ((self.high - self.low) / self.step).round() as usize;
        (0..=count).map(|k| self.low + self.step * k as f64)
    }

    /// Label of a tick. Very large and very small numbers are in units of [`Axis::power`].
    pub fn label(&self, value: f64) -> String {
        let unit = 10_f64.powi(self.power());
        tick_label(value / unit, self.step / unit)
    }

    /// Power of ten omitted from the labels: 0 for ordinary numbers.
    pub fn power(&self) -> i32 {
        let largest = self.low.abs().max(self.high.abs());
        if (1e-2..1e5).contains(&largest) { 0 } else { largest.log10().floor() as i32 }
    }
}

/// A tick's value with as many decimals as its step needs, and a true minus sign.
pub fn tick_label(value: f64, step: f64) -> String {
    let decimals = (-(step.log10() + 1e-9).floor()).clamp(0.0, 12.0) as usize;
    let text = format!("{value:.decimals$}");
    if text.trim_start_matches('-').chars().all(|c| c == '0' || c == '.') {
        "0".into()
    } else {
        text.replace('-', "−")
    }
}

/// A power of ten in print: 10⁻³.
pub fn power_of_ten(power: i32) -> String {
    let digit = |c| match c {
        '-' => '⁻',
        '1' => '¹',
        '2' => '²',
        '3' => '³',
        // The other superscripts are consecutive, starting from 0.
        c => char::from_u32('⁰' as u32 + c as u32 - '0' as u32).unwrap_or('?'),
    };
    format!("10{}", power.to_string().chars().map(digit).collect::<String>())
}

/// The largest of 1, 2 and 5 times a power of ten that is not above a length.
pub fn nice_at_most(length: f64) -> f64 {
    let decade = decade_below(length);
    [5.0, 2.0].into_iter().find(|step| step * decade <= length).unwrap_or(1.0) * decade
}

/// The smallest of 1, 2 and 5 times a power of ten that is not below a length.
pub fn nice_at_least(length: f64) -> f64 {
    let decade = decade_below(length);
    [1.0, 2.0, 5.0].into_iter().find(|step| step * decade >= length).unwrap_or(10.0) * decade
}

fn decade_below(length: f64) -> f64 {
    10_f64.powf(length.log10().floor())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_are_rounded_to_ones_twos_and_fives() {
        for (length, down, up) in [(25.0, 20.0, 50.0), (0.7, 0.5, 1.0), (100.0, 100.0, 100.0), (43.0, 20.0, 50.0)] {
            assert_eq!(nice_at_most(length), down, "{length}");
            assert_eq!(nice_at_least(length), up, "{length}");
        }
    }

    #[test]
    fn axes_round_out_and_place_their_ends() {
        let axis = Axis::over([0.13, 0.97, f64::NAN].into_iter(), [100.0, 500.0], 6);
        assert!((axis.low - 0.0).abs() < 1e-12 && (axis.high - 1.0).abs() < 1e-12, "{} {}", axis.low, axis.high);
        assert_eq!((axis.place(axis.low), axis.place(axis.high)), (100.0, 500.0));
        let labels: Vec<String> = axis.ticks().map(|tick| axis.label(tick)).collect();
        assert_eq!(labels, ["0", "0.2", "0.4", "0.6", "0.8", "1.0"]);
    }

    #[test]
    fn whole_steps_need_no_room_and_minus_signs_are_minus_signs() {
        let axis = Axis::over([-0.3, 0.3].into_iter(), [0.0, 1.0], 6);
        let labels: Vec<String> = axis.ticks().map(|tick| axis.label(tick)).collect();
        assert_eq!(labels, ["−0.3", "−0.2", "−0.1", "0", "0.1", "0.2", "0.3"]);
    }

    #[test]
    fn large_and_small_numbers_share_a_power_of_ten() {
        let axis = Axis::over([0.0, 2.4e-4].into_iter(), [0.0, 1.0], 6);
        assert_eq!((axis.power(), axis.label(5e-5)), (-4, "0.5".into()));
        assert_eq!(power_of_ten(-4), "10⁻⁴");
        assert_eq!(power_of_ten(12), "10¹²");
        assert_eq!(power_of_ten(30), "10³⁰");
    }
}
