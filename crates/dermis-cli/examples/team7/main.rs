//! Prints the flux density of TEAM Workshop Problem 7 on its two measured lines, in 1e-4 T, as CSV.
//!
//! `cargo run --release --example team7 -- --frequency 50`

use std::process::ExitCode;

use clap::Parser;
use dermis_lab::evidence::team7::{X_MM, flux_density, mesh};

#[derive(Parser)]
struct Arguments {
    /// Frequency, hertz.
    #[arg(long, default_value_t = 50.0)]
    frequency: f64,
    /// Cells of the mesh between two of its planes; 0 gives a coarser mesh.
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u8).range(0..=3))]
    fine: u8,
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    let found = mesh(arguments.fine.into()).and_then(|mesh| flux_density(&mesh, arguments.frequency));
    match found {
        Ok(rows) => {
            println!("x_mm,Bz_A1B1_re,Bz_A1B1_im,Bz_A2B2_re,Bz_A2B2_im");
            for (x, [a, b, c, d]) in X_MM.iter().zip(rows) {
                println!("{x},{a:.3},{b:.3},{c:.3},{d:.3}");
            }
            ExitCode::SUCCESS
        }
        Err(error) => {
            eprintln!("{error}");
            ExitCode::FAILURE
        }
    }
}
