//! `dermis solve`: voltages, Jacobian and difference images of a case file, for scripts and comparisons.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use dermis_device::instruments::npy;
use dermis_lab::case::{Case, ConductivityChoice};
use dermis_lab::solve::{DifferencePrior, DifferenceSpec, difference_image};
use dermis_tomo::eit::ForwardModel;

use super::skin_word;
use crate::exit::{Outcome, UsageError};

const EXAMPLE: &str = "\
Examples:
  dermis solve case.json --sigma hom --voltages v.npy --jacobian j.npy
  dermis solve case.json --difference hom:incl --prior noser \\
      --hyperparameter 0.1 --image x.npy

A Gmsh mesh (MSH 2.2 or 4.1) with its electrodes as groups electrode_1, electrode_2, ... takes the rest from a \
skin, as in `dermis solve tank.msh --skin tank.toml --unit mm --sigma hom --voltages v.npy`.

A conductivity is hom, incl, wave, any other NAME for which the case has sigma_NAME, or a file (NumPy array or text \
column) with one value per element. Arrays are float64: voltages (m,), Jacobian (m, n), image (n,), for m \
measurements and n elements.";

/// Arguments of `dermis solve`.
#[derive(clap::Args)]
#[command(after_help = EXAMPLE)]
#[command(group(clap::ArgGroup::new("outputs").args(["voltages", "jacobian", "image"]).required(true).multiple(true)))]
pub struct Arguments {
    /// The case: mesh, electrodes, stimulation, measurement, conductivities; or a Gmsh mesh, with --skin.
    #[arg(value_name = "CASE.json|MESH.msh")]
    case: PathBuf,
    /// Skin whose protocol, contact impedance and conductance (hom) are used with a mesh.
    #[arg(long, value_name = "SKIN")]
    skin: Option<String>,
    /// Prefix of the electrode groups' names in a mesh.
    #[arg(long, value_name = "PREFIX", default_value = "electrode", requires = "skin")]
    electrodes: String,
    /// Unit of a mesh's coordinates.
    #[arg(long, value_enum, requires = "skin")]
    unit: Option<Unit>,
    /// Conductivity for voltages and Jacobian.
    #[arg(long, value_name = "hom|incl|wave|FILE")]
    sigma: Option<ConductivityChoice>,
    /// Output file for the voltages (volts).
    #[arg(long, value_name = "FILE.npy", requires = "sigma")]
    voltages: Option<PathBuf>,
    /// Output file for the Jacobian dv/dsigma.
    #[arg(long, value_name = "FILE.npy", requires = "sigma")]
    jacobian: Option<PathBuf>,
    /// Conductivities before and after; the difference of their voltages is imaged.
    #[arg(long, value_name = "FROM:TO", requires = "image")]
    difference: Option<Difference>,
    /// Prior of the image.
    #[arg(long, value_enum, requires = "difference")]
    prior: Option<PriorName>,
    /// Hyperparameter lambda of (J'WJ + lambda^2 R)^-1 J'W dv.
    #[arg(long, value_name = "LAMBDA", allow_negative_numbers = true, requires = "difference", value_parser = positive)]
    hyperparameter: Option<f64>,
    /// Image v/v0 - 1, weighted by the squared voltages of unit conductivity, instead of v - v0.
    #[arg(long, visible_alias = "normalized", requires = "difference")]
    normalised: bool,
    /// Output file for the image (change of conductivity of each element).
    #[arg(long, value_name = "FILE.npy", requires_all = ["difference", "prior", "hyperparameter"])]
    image: Option<PathBuf>,
}

#[derive(Clone, Copy, clap::ValueEnum)]
enum Unit {
    M,
    Cm,
    Mm,
}

impl Unit {
    fn metres(self) -> f64 {
        match self {
            Self::M => 1.0,
            Self::Cm => 1e-2,
            Self::Mm => 1e-3,
        }
    }
}

#[derive(Clone, Copy, clap::ValueEnum)]
enum PriorName {
    Noser,
    Laplace,
    #[value(alias = "tikhonov")]
    Identity,
}

impl From<PriorName> for DifferencePrior {
    fn from(name: PriorName) -> Self {
        match name {
            PriorName::Noser => DifferencePrior::Noser,
            PriorName::Laplace => DifferencePrior::Laplace,
            PriorName::Identity => DifferencePrior::Identity,
        }
    }
}

/// Two conductivities, `FROM:TO`.
#[derive(Clone)]
struct Difference {
    reference: ConductivityChoice,
    changed: ConductivityChoice,
}

impl FromStr for Difference {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let expected = || "expected two conductivities as in hom:incl".to_string();
        let (from, to) = text.split_once(':').ok_or_else(expected)?;
        Ok(Self { reference: from.parse().map_err(|_| expected())?, changed: to.parse().map_err(|_| expected())? })
    }
}

fn positive(text: &str) -> Result<f64, String> {
    let value = text.parse::<f64>().ok().filter(|value| *value > 0.0 && value.is_finite());
    value.ok_or_else(|| "expected a positive number".to_string())
}

/// An array to write once all arrays are computed.
struct Output<'a> {
    what: &'static str,
    path: &'a Path,
    shape: Vec<usize>,
    values: Vec<f64>,
}

impl Arguments {
    /// Computes all requested arrays, then writes them.
    pub fn run(&self, out: &mut dyn Write) -> anyhow::Result<Outcome> {
        self.check_paths()?;
        let is_mesh = self.case.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("msh"));
        let case = match &self.skin {
            Some(skin) => {
                Case::of_mesh(&self.case, &skin_word::skin(skin)?, &self.electrodes, self.unit.map(Unit::metres))?
            }
            None if is_mesh => {
                let name = self.case.display();
                return Err(
                    UsageError(format!("{name}: a mesh; expected --skin SKIN with it, for the protocol")).into()
                );
            }
            None => Case::open(&self.case)?,
        };
        let model = case.forward_model()?;
        tracing::info!(
            nodes = case.body.mesh.nodes().len(),
            elements = case.body.mesh.element_count(),
            electrodes = case.body.electrodes.len(),
            measurements = case.protocol.channel_count(),
            "read {}",
            self.case.display()
        );
        let mut outputs = self.forward(&case, &model)?;
        outputs.extend(self.difference_image(&case, &model)?);
        for output in &outputs {
            npy::write_f64(output.path, &output.shape, &output.values)?;
            let shape: Vec<String> = output.shape.iter().map(ToString::to_string).collect();
            writeln!(out, "{}: {} values to {}", output.what, shape.join(" x "), output.path.display())?;
        }
        Ok(Outcome::Done)
    }

    fn forward<'a>(&'a self, case: &Case, model: &ForwardModel) -> anyhow::Result<Vec<Output<'a>>> {
        let Some(sigma) = &self.sigma else { return Ok(Vec::new()) };
        let solution = model.solve(&case.conductivity(sigma)?).map_err(dermis_lab::Error::from)?;
        let mut outputs = Vec::new();
        if let Some(path) = &self.voltages {
            let values = solution.voltages();
            outputs.push(Output { what: "voltages", path, shape: vec![values.len()], values });
        }
        if let Some(path) = &self.jacobian {
            let jacobian = solution.jacobian();
            let shape = vec![jacobian.rows, jacobian.columns];
            outputs.push(Output { what: "Jacobian", path, shape, values: jacobian.values });
        }
        Ok(outputs)
    }

    fn difference_image<'a>(&'a self, case: &Case, model: &ForwardModel) -> anyhow::Result<Option<Output<'a>>> {
        let (Some(difference), Some(prior), Some(hyperparameter), Some(path)) =
            (&self.difference, self.prior, self.hyperparameter, &self.image)
        else {
            return Ok(None);
        };
        let spec = DifferenceSpec { prior: prior.into(), hyperparameter, normalised: self.normalised };
        let reference = case.conductivity(&difference.reference)?;
        let values = difference_image(model, &reference, &case.conductivity(&difference.changed)?, &spec)?;
        Ok(Some(Output { what: "image", path, shape: vec![values.len()], values }))
    }

    /// Refuses to write two arrays to one file, or an array over the case.
    fn check_paths(&self) -> Result<(), UsageError> {
        let mut taken = vec![("the case", &self.case)];
        for (flag, path) in [("--voltages", &self.voltages), ("--jacobian", &self.jacobian), ("--image", &self.image)] {
            let Some(path) = path else { continue };
            if let Some((other, _)) = taken.iter().find(|(_, other)| *other == path) {
                let path = path.display();
                return Err(UsageError(format!("{flag} {path}: is also {other}; expected different files")));
            }
            taken.push((flag, path));
        }
        Ok(())
    }
}
