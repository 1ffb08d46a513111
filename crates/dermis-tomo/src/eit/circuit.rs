//! The readout circuit around a skin. Every line that connects a real instrument to an electrode leaks current to the
//! instrument's ground, and a reading may not be a plain difference between two electrodes. With `G` the admittance
//! matrix of the skin between its electrodes and `Y` the diagonal matrix of the lines' admittances to ground, the
//! electrode potentials of a channel solve `(G + Y) V = s`, and its reading is `v = r . V`.
//!
//! Sensitivity: `dv = -r' A^-1 dG A^-1 s` with `A = G + Y`. Let `V = A^-1 s` and `W = A^-1 r` (`A` is symmetric). At
//! fixed electrode potentials the dissipated power is stationary in the interior field, so
//! `V' dG W = int dsigma grad u_V . grad u_W`. Here `u_V` is the field between electrodes at potentials `V`, which is
//! the field of the electrode currents `I = G V`; the same holds for `W` and `K = G W`. Hence
//! `dv/dsigma = -int grad u_I . grad u_K`: the usual adjoint Jacobian with the *effective* stimulation `I` and the
//! *effective* measuring pattern `K` instead of the nominal pairs. Both sum to zero over the electrodes because the
//! rows of `G` do, so they form an ordinary [`Protocol`].

use std::collections::HashMap;

use faer::{Mat, MatRef, Side, linalg::solvers::Solve};

use super::error::{CircuitError, EitError};
use super::forward::Solution;
use super::protocol::{Pattern, Protocol};

/// One value for each of the three lines that a channel connects besides the source.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lines {
    /// The electrode that takes the current back (negative in the stimulation).
    pub sink: f64,
    /// The electrode read with positive sign.
    pub plus: f64,
    /// The electrode read with negative sign.
    pub minus: f64,
}

/// Return path of the source current to the instrument.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CurrentReturn {
    /// Through the loads alone: the source works against ground, and the sink is a loaded line like the others.
    Ground,
    /// The sink draws exactly the current of the source; loads only redistribute it.
    Sink,
}

/// Effect of an instrument on a channel: loads on its lines, and the combination of potentials that it reads.
///
/// Admittances are relative to the skin's sheet conductance (conductivity times thickness, S), because only their
/// ratio matters for relative changes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReadoutCircuit {
    /// Admittance to ground of the connected lines, relative. Lines on one electrode add.
    pub load: Lines,
    /// Admittance to ground of every other electrode, including the source, relative.
    pub idle: f64,
    /// Weights of the potentials in the reading, per unit weight of the channel's measuring pair.
    pub reading: Lines,
    /// Return path of the current.
    pub current_return: CurrentReturn,
}

/// Readings of a circuit, and the protocol with the same Jacobian.
#[derive(Clone, Debug, PartialEq)]
pub struct CircuitResponse {
    /// One signed reading per channel, volts.
    pub voltages: Vec<f64>,
    /// Effective stimulations (A) and measuring patterns, one pair per channel. Its *Jacobian* is
    /// `d voltages / d sigma` at the conductivity of the solution. Its voltages differ from the readings, which
    /// include a contribution of the loads.
    pub effective: Protocol,
}

impl ReadoutCircuit {
    /// Effective circuit of the OpenEIT-derived board of the gelatin skin by Hardman, Thuruthel and Iida
    /// (DSHardman/HydrogelEIT). The source works against ground, sink and both measuring lines load the skin equally,
    /// and the negative electrode is read against the mean of the other two lines. The loads were chosen by the
    /// median score of [`SelfCalibration`](crate::inverse::SelfCalibration) and by baselines; the result is
    /// insensitive to both (a factor of two either way costs about 1 mm).
    pub const HYDROGEL_BOARD: Self = Self {
        load: Lines { sink: 0.47, plus: 0.47, minus: 0.47 },
        idle: 0.15,
        reading: Lines { sink: -0.5, plus: -0.5, minus: 1.0 },
        current_return: CurrentReturn::Ground,
    };

    /// A differential reading of balanced currents with the same relative load on every line. For `load` going to
    /// zero it becomes the plain model of [`Solution::voltages`]. It would not with [`CurrentReturn::Ground`]: the
    /// current then leaves through all loads in proportion, however small they are.
    pub fn differential(load: f64) -> Self {
        Self {
            load: Lines { sink: load, plus: load, minus: load },
            idle: load,
            reading: Lines { sink: 0.0, plus: 1.0, minus: -1.0 },
            current_return: CurrentReturn::Sink,
        }
    }

    /// Readings and effective protocol of a solved skin. `sheet_conductance_s` converts the relative admittances to
    /// siemens (the homogeneous conductivity given to the solver of a sheet; conductivity times thickness for a
    /// slab). The positive electrode of each stimulation is the source.
    ///
    /// # Errors
    /// Channels that are not a driven pair and a read pair, values that are negative or not finite, no load at all,
    /// or electrodes that share a node.
    pub fn response(&self, solution: &Solution<'_>, sheet_conductance_s: f64) -> Result<CircuitResponse, EitError> {
        self.validate(sheet_conductance_s)?;
        let protocol = solution.model().protocol();
        let admittance = electrode_admittance(solution.transfer_impedance())?;
        let mut stimulations = Vec::new();
        let mut known: HashMap<Vec<u64>, usize> = HashMap::new();
        let mut channels = Vec::with_capacity(protocol.channel_count());
        let mut voltages = Vec::with_capacity(protocol.channel_count());
        for channel in 0..protocol.channel_count() {
            let connection = Connection::of(protocol, channel)?;
            let solved = self.solve(&connection, &admittance, sheet_conductance_s);
            let solved = solved.ok_or(CircuitError::Floating { channel })?;
            let stimulation = *known.entry(connection.key()).or_insert_with(|| {
                stimulations.push(solved.stimulation);
                stimulations.len() - 1
            });
            channels.push((solved.reading, stimulation));
            voltages.push(solved.voltage);
        }
        // Patterns computed from an admittance matrix are balanced and finite.
        let effective = Protocol::from_patterns(protocol.electrode_count(), stimulations, channels)
            .map_err(|_| CircuitError::Impedance)?;
        Ok(CircuitResponse { voltages, effective })
    }

    /// Readings of a protocol's channels, volts, signed, for a skin with these transfer impedances between its
    /// electrodes ([`Solution::transfer_impedance`]), whatever their origin; otherwise as
    /// [`ReadoutCircuit::response`].
    ///
    /// # Errors
    /// As [`ReadoutCircuit::response`].
    pub fn voltages(
        &self,
        protocol: &Protocol,
        impedance: MatRef<'_, f64>,
        sheet_conductance_s: f64,
    ) -> Result<Vec<f64>, EitError> {
        self.validate(sheet_conductance_s)?;
        let admittance = electrode_admittance(impedance)?;
        let read = |channel: usize| -> Result<f64, CircuitError> {
            let connection = Connection::of(protocol, channel)?;
            let solved = self.solve(&connection, &admittance, sheet_conductance_s);
            Ok(solved.ok_or(CircuitError::Floating { channel })?.voltage)
        };
        Ok((0..protocol.channel_count()).map(read).collect::<Result<_, CircuitError>>()?)
    }

    fn validate(&self, sheet_conductance_s: f64) -> Result<(), CircuitError> {
        let admittances = [
            ("load of the sink", self.load.sink),
            ("load of the plus line", self.load.plus),
            ("load of the minus line", self.load.minus),
            ("load of an idle line", self.idle),
        ];
        let weights = [
            ("reading weight of the sink", self.reading.sink),
            ("reading weight of the plus line", self.reading.plus),
            ("reading weight of the minus line", self.reading.minus),
        ];
        let refuse = |field, value, expected| Err(CircuitError::Value { field, value, expected });
        for (field, value) in admittances {
            if !(value >= 0.0 && value.is_finite()) {
                return refuse(field, value, "zero or positive and finite");
            }
        }
        for (field, value) in weights {
            if !value.is_finite() {
                return refuse(field, value, "finite");
            }
        }
        if !(sheet_conductance_s > 0.0 && sheet_conductance_s.is_finite()) {
            return refuse("sheet conductance in S", sheet_conductance_s, "positive and finite");
        }
        Ok(())
    }

    /// `None` if `G + Y` is singular.
    fn solve(&self, lines: &Connection, admittance: &Mat<f64>, conductance: f64) -> Option<SolvedChannel> {
        let count = admittance.nrows();
        let connected = [(lines.sink, self.load.sink), (lines.plus, self.load.plus), (lines.minus, self.load.minus)];
        let mut loaded = admittance.clone();
        let mut to_ground = 0.0;
        for electrode in 0..count {
            let mut load = None;
            for (_, value) in connected.iter().filter(|line| line.0 == electrode) {
                load = Some(load.unwrap_or(0.0) + value);
            }
            let load = conductance * load.unwrap_or(self.idle);
            loaded[(electrode, electrode)] += load;
            to_ground += load;
        }
        // Rounding may make the skin's own singular matrix look positive definite.
        if to_ground == 0.0 {
            return None;
        }
        let mut sides = Mat::<f64>::zeros(count, 2);
        sides[(lines.source, 0)] += lines.current;
        if self.current_return == CurrentReturn::Sink {
            sides[(lines.sink, 0)] -= lines.current;
        }
        sides[(lines.sink, 1)] += lines.weight * self.reading.sink;
        sides[(lines.plus, 1)] += lines.weight * self.reading.plus;
        sides[(lines.minus, 1)] += lines.weight * self.reading.minus;
        let potentials = loaded.llt(Side::Lower).ok()?.solve(&sides);
        let voltage: f64 = (0..count).map(|electrode| sides[(electrode, 1)] * potentials[(electrode, 0)]).sum();
        let currents = admittance * &potentials;
        let finite = (0..count).all(|row| currents[(row, 0)].is_finite() && currents[(row, 1)].is_finite());
        let pattern =
            |column: usize| Pattern::new((0..count).map(|row| (row as u32, currents[(row, column)])).collect());
        finite.then(|| SolvedChannel { voltage, stimulation: pattern(0), reading: pattern(1) })
    }
}

struct SolvedChannel {
    voltage: f64,
    stimulation: Pattern,
    reading: Pattern,
}

/// The electrodes of a channel.
struct Connection {
    source: usize,
    sink: usize,
    plus: usize,
    minus: usize,
    /// Current, amperes.
    current: f64,
    weight: f64,
}

impl Connection {
    fn of(protocol: &Protocol, channel: usize) -> Result<Self, CircuitError> {
        let (source, sink, current) = pair("stimulation", channel, protocol.stimulation_of(channel))?;
        let (plus, minus, weight) = pair("measuring pattern", channel, protocol.pattern_of(channel))?;
        Ok(Self { source, sink, plus, minus, current, weight })
    }

    fn key(&self) -> Vec<u64> {
        let electrodes = [self.source, self.sink, self.plus, self.minus].map(|electrode| electrode as u64);
        electrodes.into_iter().chain([self.current.to_bits()]).collect()
    }
}

/// Positive electrode, negative electrode, and weight of the positive one.
fn pair(what: &'static str, channel: usize, pattern: &Pattern) -> Result<(usize, usize, f64), CircuitError> {
    match *pattern.entries() {
        [(a, first), (b, second)] if first * second < 0.0 && (first + second).abs() <= 1e-9 * first.abs() => {
            let (plus, minus) = if first > 0.0 { (a, b) } else { (b, a) };
            Ok((plus as usize, minus as usize, first.abs()))
        }
        ref other => Err(CircuitError::NotAPair { channel, what, entries: other.len(), sum: pattern.sum() }),
    }
}

/// `G`, electrodes x electrodes in siemens: currents into the skin for given electrode potentials. Its rows sum to
/// zero.
fn electrode_admittance(impedance: MatRef<'_, f64>) -> Result<Mat<f64>, CircuitError> {
    let last = impedance.nrows() - 1;
    let factor = impedance.submatrix(0, 0, last, last).llt(Side::Lower).map_err(|_| CircuitError::Impedance)?;
    let inverse = factor.solve(Mat::<f64>::identity(last, last));
    let row_sum = |row: usize| (0..last).map(|column| inverse[(row, column)]).sum::<f64>();
    let total: f64 = (0..last).map(row_sum).sum();
    Ok(Mat::from_fn(last + 1, last + 1, |row, column| match (row == last, column == last) {
        (false, false) => 0.5 * (inverse[(row, column)] + inverse[(column, row)]),
        (false, true) => -row_sum(row),
        (true, false) => -row_sum(column),
        (true, true) => total,
    }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::eit::ForwardModel;
    use crate::mesh::{Direction, ElectrodedMesh, Outline, SheetSpec};

    const ELECTRODES: usize = 8;

    fn body_with(contact_impedance: f64) -> ElectrodedMesh {
        let outline = Outline::Disc { radius_m: 0.05 };
        let electrodes = Outline::rim_arcs(ELECTRODES, 0.006, 0.3, Direction::CounterClockwise);
        SheetSpec::new(outline, electrodes, 0.012).build(&[contact_impedance]).unwrap().0
    }

    fn body() -> ElectrodedMesh {
        body_with(1e-3)
    }

    /// Opposite drives, each with all neighbouring pairs of undriven electrodes.
    fn protocol() -> Protocol {
        let count = ELECTRODES as u32;
        let mut channels = Vec::new();
        for drive in 0..count {
            for plus in 0..count {
                let (sink, minus) = ((drive + count / 2) % count, (plus + 1) % count);
                if ![drive, sink].contains(&plus) && ![drive, sink].contains(&minus) {
                    channels.push((Pattern::pair(plus, minus, 1.0), drive as usize));
                }
            }
        }
        let stimulations = (0..count).map(|k| Pattern::pair(k, (k + count / 2) % count, 2e-3)).collect();
        Protocol::from_patterns(ELECTRODES, stimulations, channels).unwrap()
    }

    /// A conductivity that varies by a factor of three.
    fn conductivity(body: &ElectrodedMesh) -> Vec<f64> {
        let at = |element: usize| body.mesh.centroid(element);
        (0..body.mesh.element_count()).map(|e| 0.02 * (1.0 + 0.5 * (60.0 * at(e)[0] - 40.0 * at(e)[1]).sin())).collect()
    }

    #[test]
    fn the_jacobian_of_the_effective_protocol_is_the_derivative_of_the_reading() {
        let body = body();
        let sigma = conductivity(&body);
        let model = ForwardModel::new(body.clone(), protocol()).unwrap();
        let circuit =
            ReadoutCircuit { load: Lines { sink: 0.9, plus: 0.3, minus: 0.6 }, ..ReadoutCircuit::HYDROGEL_BOARD };
        let response = |sigma: &[f64]| circuit.response(&model.solve(sigma).unwrap(), 0.02).unwrap();
        let effective = ForwardModel::new(body, response(&sigma).effective).unwrap();
        let jacobian = effective.solve(&sigma).unwrap().jacobian();
        for element in (0..sigma.len()).step_by(sigma.len() / 7) {
            let step = 1e-4 * sigma[element];
            let moved = |by: f64| {
                let mut sigma = sigma.clone();
                sigma[element] += by;
                response(&sigma).voltages
            };
            let (more, less) = (moved(step), moved(-step));
            let largest = (0..more.len()).map(|c| jacobian.row(c)[element].abs()).fold(0.0, f64::max);
            for channel in 0..more.len() {
                let difference = (more[channel] - less[channel]) / (2.0 * step);
                // Central differences: truncation 1e-8 relative, rounding 1e-15 of v over 1e-4 of dv.
                assert!((difference - jacobian.row(channel)[element]).abs() < 1e-6 * largest);
            }
        }
    }

    #[test]
    fn a_vanishing_load_gives_the_plain_model() {
        let body = body();
        let sigma = conductivity(&body);
        let model = ForwardModel::new(body, protocol()).unwrap();
        let solution = model.solve(&sigma).unwrap();
        let plain = solution.voltages();
        let largest = plain.iter().fold(0.0, |most: f64, v| most.max(v.abs()));
        let deviation = |circuit: ReadoutCircuit| {
            let found = circuit.response(&solution, 0.02).unwrap().voltages;
            found.iter().zip(&plain).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max) / largest
        };
        let (some, little) =
            (deviation(ReadoutCircuit::differential(1e-4)), deviation(ReadoutCircuit::differential(1e-6)));
        // First order in the load.
        assert!(little < 1e-5 && (some / little - 100.0).abs() < 1.0, "{some:e} {little:e}");
        // A source against ground stays far from the plain model even with tiny loads: the current returns through
        // all of them.
        let grounded = ReadoutCircuit { current_return: CurrentReturn::Ground, ..ReadoutCircuit::differential(1e-6) };
        assert!(deviation(grounded) > 0.1);
        // Unless one line is practically ground: a grounded sink gives the plain model again.
        let load = Lines { sink: 1e7, plus: 1e-7, minus: 1e-7 };
        assert!(deviation(ReadoutCircuit { load, idle: 1e-7, ..grounded }) < 1e-5);
    }

    #[test]
    fn relative_loads_make_the_response_scale_with_resistance() {
        let body = body();
        let sigma = conductivity(&body);
        let four: Vec<f64> = sigma.iter().map(|s| 4.0 * s).collect();
        let response = |body: ElectrodedMesh, sigma: &[f64], sheet: f64| {
            let model = ForwardModel::new(body, protocol()).unwrap();
            ReadoutCircuit::HYDROGEL_BOARD.response(&model.solve(sigma).unwrap(), sheet).unwrap()
        };
        let (one, fourth) = (response(body, &sigma, 0.02), response(body_with(2.5e-4), &four, 0.08));
        for (a, b) in one.voltages.iter().zip(&fourth.voltages) {
            assert!((a - 4.0 * b).abs() < 1e-9 * a.abs().max(1e-3), "{a} {b}");
        }
    }

    #[test]
    fn effective_patterns_are_balanced_and_one_per_connection() {
        let body = body();
        let sigma = conductivity(&body);
        let model = ForwardModel::new(body, protocol()).unwrap();
        let response = ReadoutCircuit::HYDROGEL_BOARD.response(&model.solve(&sigma).unwrap(), 0.02).unwrap();
        assert_eq!(response.effective.channel_count(), protocol().channel_count());
        assert_eq!(response.effective.stimulations().len(), protocol().channel_count());
        for channel in 0..protocol().channel_count() {
            assert!(response.effective.stimulation_of(channel).sum().abs() < 1e-12);
            assert!(response.effective.pattern_of(channel).sum().abs() < 1e-12);
        }
    }

    #[test]
    fn refusals_name_channel_and_value() {
        let body = body();
        let sigma = conductivity(&body);
        let model = ForwardModel::new(body.clone(), protocol()).unwrap();
        let solution = model.solve(&sigma).unwrap();
        let refused = |circuit: ReadoutCircuit, sheet: f64| circuit.response(&solution, sheet).unwrap_err().to_string();
        assert!(refused(ReadoutCircuit::differential(-1.0), 0.02).contains("load of the sink: -1"));
        assert!(refused(ReadoutCircuit::differential(0.0), 0.02).contains("channel 0"));
        assert!(refused(ReadoutCircuit::HYDROGEL_BOARD, f64::NAN).contains("sheet conductance"));
        let dense = Pattern::new((0..8).map(|k| (k, if k < 4 { 1.0 } else { -1.0 })).collect());
        let channels = vec![(Pattern::pair(1, 2, 1.0), 0)];
        let model =
            ForwardModel::new(body, Protocol::from_patterns(ELECTRODES, vec![dense], channels).unwrap()).unwrap();
        let error = ReadoutCircuit::HYDROGEL_BOARD.response(&model.solve(&sigma).unwrap(), 0.02).unwrap_err();
        let expected = CircuitError::NotAPair { channel: 0, what: "stimulation", entries: 8, sum: 0.0 };
        assert_eq!(error, EitError::Circuit(expected));
    }
}
