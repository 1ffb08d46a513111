//! All data sets: their descriptions, what was tuned on them, and a function to run each.

use std::path::{Path, PathBuf};
use std::time::Instant;

use super::bench::{Bench, Extent, Stop};
use super::finding::Finding;
use super::{five_skins, gel_watch, golfball, hydrogel, ktc, pyeidors, sciospec, team7};
use crate::Error;

/// A set of measured data.
pub struct Set {
    /// Name for the command, and of the folder.
    pub name: &'static str,
    /// The measurement in one line.
    pub title: &'static str,
    /// Origin of the data.
    pub source: &'static str,
    /// Parts of dermis that were tuned on these data.
    pub tuned: &'static str,
    /// Parts that were not tuned on them.
    pub not_tuned: &'static str,
    measure: fn(&mut Bench<'_>) -> Result<(), Stop>,
}

/// Result of running a set.
#[derive(Debug)]
pub struct SetReport {
    /// Rows in the order in which they were made. Rows from before a failure are kept.
    pub findings: Vec<Finding>,
    /// Files and folders that are missing.
    pub missing: Vec<PathBuf>,
    /// The error that ended the run early.
    pub failed: Option<Error>,
    /// Duration of the run, seconds.
    pub seconds: f64,
}

impl SetReport {
    /// True if nothing of the set is present.
    pub fn is_missing(&self) -> bool {
        self.findings.is_empty() && self.failed.is_none()
    }
}

impl Set {
    /// The set with this name.
    pub fn named(name: &str) -> Option<&'static Set> {
        SETS.iter().find(|set| set.name == name)
    }

    /// Runs dermis on the set, which is in the folder of its name inside `data`. `tell` is called with each step.
    pub fn measure(&self, data: &Path, extent: Extent, tell: &mut dyn FnMut(&str)) -> SetReport {
        let begun = Instant::now();
        let mut bench = Bench::new(data.join(self.name), extent, tell);
        let mut failed = None;
        match (self.measure)(&mut bench) {
            Ok(()) => {}
            Err(Stop::Missing(path)) => bench.missing.push(path),
            Err(Stop::Failed(error)) => failed = Some(error),
        }
        let Bench { findings, missing, .. } = bench;
        SetReport { findings, missing, failed, seconds: begun.elapsed().as_secs_f64() }
    }
}

impl std::fmt::Debug for Set {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.debug_struct("Set").field("name", &self.name).finish_non_exhaustive()
    }
}

/// All sets that dermis has been tried on.
pub const SETS: [Set; 8] = [
    Set {
        name: "hydrogel",
        title: "a round gelatin skin, 16 electrodes, 500 presses by a robot",
        source: "D. Hardman, T. G. Thuruthel and F. Iida, HydrogelEIT (`ohmc16`)",
        tuned: "the form of the board's circuit, with known positions; its loads and weights, by the score of unlabelled \
                frames; size of a touch, noise floor and band of the centroid; the calibration's rules",
        not_tuned: "hyperparameters of a calibration, which are chosen by leaving out pokes of the draw",
        measure: hydrogel::measure,
    },
    Set {
        name: "five-skins",
        title: "skins of one family, conductive patterns cast into a gel, 2,500 presses each by a robot",
        source: "D. Hardman, T. G. Thuruthel and F. Iida, Variable-Sensitivity-E-Skins",
        tuned: "the calibration's two experts and their combination; the guessed square",
        not_tuned: "any setting to other folders of the set",
        measure: five_skins::measure,
    },
    Set {
        name: "hydrogel-damage",
        title: "a gel skin watched for two hours, with two disturbances",
        source: "D. Hardman, T. G. Thuruthel and F. Iida, HydrogelEIT (`DamageTests`)",
        tuned: "the watch: following drift, three frames of rest, a tenth of the disturbance, `smallest_depth` 0.006",
        not_tuned: "the model of the skin and its circuit, which come from `hydrogel`",
        measure: gel_watch::measure,
    },
    Set {
        name: "ktc",
        title: "a water tank with 32 electrodes, 4 training phantoms with photographed ground truth",
        source: "Kuopio Tomography Challenge 2023",
        tuned: "the recipe of all four tanks (weights, prior, hyperparameter rule); the soft threshold of the images, the \
                thresholds of the labels, and the rule for using the network's labels",
        not_tuned: "the network's weights, which come from simulated frames",
        measure: ktc::measure,
    },
    Set {
        name: "golfball",
        title: "balls of 2 cm radius in a saline tank of 30 cm, 16 electrodes",
        source: "M. Soleimani, C. Gomez-Laberge and A. Adler, 2006 (EIDORS sample data)",
        tuned: "the recipe of all four tanks; gain by channel for this deep tank",
        not_tuned: "any setting to the balls' positions",
        measure: golfball::measure,
    },
    Set {
        name: "pyeidors-tank",
        title: "metal and plastic at named electrodes of a tank, 16 electrodes",
        source: "PyEIDORS sample data",
        tuned: "the recipe of all four tanks; gain by regression with intercept, and touches from half of the strongest",
        not_tuned: "any setting to single files or objects",
        measure: pyeidors::measure,
    },
    Set {
        name: "sciospec",
        title: "a cup moved through a tank by hand, 255 frames of a Sciospec instrument",
        source: "Sciospec, sciospec_EIT_matlab_example",
        tuned: "the recipe of all four tanks; touches from a relative conductivity of 0.08",
        not_tuned: "any setting to the frame at which the cup enters",
        measure: sciospec::measure,
    },
    Set {
        name: "team7",
        title: "a racetrack coil over an aluminium plate with a hole, 50 Hz",
        source: "K. Fujiwara and T. Nakata, COMPEL 9, 137 (1990), TEAM Workshop Problem 7",
        tuned: "the mesh, after comparing the deviations of three",
        not_tuned: "the physics",
        measure: team7::measure,
    },
];
