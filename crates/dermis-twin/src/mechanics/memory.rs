//! First-order viscoelastic memory of a cover. The share `1 - c` of a pressure `p` acts at once and the share `c`
//! follows with a time constant, `tau dq/dt = p - q`, `p_eff = (1 - c) p + c q` (a standard linear solid seen at its
//! base). Exact for pressures that are constant over each step.

use serde::{Deserialize, Serialize};

use crate::error::{TwinError, check, check_positive};

/// Parameters of the memory.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Memory {
    /// c: share of the pressure that acts with a delay, 0 to 1.
    pub share: f64,
    /// tau: time constant of the delay, seconds.
    pub time_constant_s: f64,
}

/// The pressure at a set of positions, with its memory.
#[derive(Clone, Debug)]
pub struct PressureState {
    memory: Option<Memory>,
    late_pa: Vec<f64>,
}

impl Memory {
    /// Checks the parameters.
    ///
    /// # Errors
    /// A share outside 0 to 1, or a time constant that is not positive.
    pub fn check(&self) -> Result<(), TwinError> {
        check("memory share", self.share, 0.0, 1.0, "0 to 1")?;
        check_positive("memory time_constant_s", self.time_constant_s)
    }
}

impl PressureState {
    /// At rest.
    pub fn new(memory: Option<Memory>, position_count: usize) -> Self {
        let remembered = if memory.is_some() { position_count } else { 0 };
        Self { memory, late_pa: vec![0.0; remembered] }
    }

    /// Converts the pressure applied during `dt_s` to the pressure that acts at its end.
    pub fn apply(&mut self, dt_s: f64, pressure_pa: &mut [f64]) {
        let Some(memory) = self.memory else { return };
        let follow = -(-dt_s / memory.time_constant_s).exp_m1();
        for (pressure, late) in pressure_pa.iter_mut().zip(&mut self.late_pa) {
            *late += follow * (*pressure - *late);
            *pressure += memory.share * (*late - *pressure);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn memory_follows_the_exponential_for_any_step() {
        let memory = Memory { share: 0.4, time_constant_s: 0.5 };
        for steps in [1, 7, 100] {
            let mut state = PressureState::new(Some(memory), 1);
            let mut pressure = [0.0];
            for _ in 0..steps {
                pressure = [10.0];
                state.apply(1.0 / f64::from(steps), &mut pressure);
            }
            let expected = 10.0 * (1.0 - 0.4 * (-2.0_f64).exp());
            assert!((pressure[0] - expected).abs() < 1e-12, "{pressure:?} {expected}");
        }
    }

    #[test]
    fn without_memory_nothing_changes() {
        let mut pressure = [3.0, 4.0];
        PressureState::new(None, 2).apply(0.1, &mut pressure);
        assert_eq!(pressure, [3.0, 4.0]);
    }
}
