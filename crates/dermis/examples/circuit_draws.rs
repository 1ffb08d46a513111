//! Measures how well the circuit of the measured gel skin is found from a few presses at unknown positions. Presses are
//! drawn at random. Each draw is judged on all other presses, whose positions serve only for that.
//!
//! ```sh
//! cargo run --release -p dermis --example circuit_draws -- DIR [DRAWS [PRESSES ...]]
//! ```
//!
//! DIR holds `ohmc16_before.csv`, `ohmc16_pressed.csv` and `ohmc16_positions.csv` (DSHardman/HydrogelEIT).

use std::path::PathBuf;
use std::time::Instant;

use dermis_device::FileSpec;
use dermis_live::calibration::{CalibratedImager, circuit_words, find_circuit, read_pokes, relative_changes};
use dermis_live::channels::ChannelReader;
use dermis_live::prepare::Prepared;
use dermis_live::reference::Reference;
use dermis_skin::{CircuitChoice, Skin};

type Failure = Box<dyn std::error::Error>;

fn main() -> Result<(), Failure> {
    let mut arguments = std::env::args().skip(1);
    let folder = PathBuf::from(arguments.next().ok_or("the folder of the presses?")?);
    let numbers: Vec<usize> = arguments.map(|word| word.parse()).collect::<Result<_, _>>()?;
    let (draws, counts) = numbers.split_first().map_or((8, &[20][..]), |(draws, counts)| (*draws, counts));
    let mut skin = Skin::open("hydrogel-disc")?;
    skin.backend.circuit = None;
    let prepared = Prepared::new(skin)?;
    let read = |name: &str| -> Result<Vec<Vec<f64>>, Failure> {
        let table = dermis_device::read(&FileSpec::all(folder.join(name)), None)?;
        let reads = prepared.skin.backend.reads;
        Ok(ChannelReader::new(table.layout(), &prepared.protocol, reads, name)?.read_table(&table)?)
    };
    let (before, pressed) = (read("ohmc16_before.csv")?, read("ohmc16_pressed.csv")?);
    let places = read_pokes(&folder.join("ohmc16_positions.csv"))?.positions_m;
    for &count in if counts.is_empty() { &[20][..] } else { counts } {
        let (mut medians, mut ninetieths) = (Vec::new(), Vec::new());
        for draw in 0..draws {
            let order = shuffled(places.len(), draw as u64);
            let (some, others) = order.split_at(count.min(order.len()));
            let pick = |frames: &[Vec<f64>]| some.iter().map(|&i| frames[i].clone()).collect::<Vec<_>>();
            let (rest, touched) = (pick(&before), pick(&pressed));
            let begun = Instant::now();
            let fit = find_circuit(&prepared, &relative_changes(&prepared, &rest, &touched)?, |_| {})?;
            let took_s = begun.elapsed().as_secs_f64();
            let mut found = prepared.skin.clone();
            found.backend.circuit = fit.circuit.map(CircuitChoice::Known);
            let found = Prepared::new(found)?;
            let mut reference = Reference::of(&found, &rest)?;
            // Calibrate on the presses rather than on the gel's behaviour between them, and count every press
            // equally.
            reference.successive.clear();
            reference.noise.iter_mut().for_each(|noise| *noise *= 1e-3);
            let difference = |reference: &Reference, i: usize| reference.difference(&pressed[i], Some(&before[i]));
            let data: Vec<Vec<f64>> = some.iter().map(|&i| difference(&reference, i)).collect();
            let CalibratedImager { reference, placement, .. } = CalibratedImager::new(&found, None, reference, &data)?;
            let mut finder = placement.ok_or("no circuit was found")?;
            let mut errors = Vec::new();
            for &i in others {
                finder.forget();
                if let Some(placement) = finder.place(0, &difference(&reference, i))? {
                    let [x, y] = placement.position_m;
                    errors.push(1e3 * (x - places[i][0]).hypot(y - places[i][1]));
                }
            }
            errors.sort_by(f64::total_cmp);
            let at = |share: f64| errors[((errors.len() as f64 * share) as usize).min(errors.len() - 1)];
            let ahead = fit.runner_up.map_or(f64::INFINITY, |other| other.behind);
            println!(
                "{count} presses, draw {draw}: {:.2} / {:.2} mm over {}; score {:.3}, before {:.3}; {ahead:.3} ahead; {}; \
                 {}; {} tried in {took_s:.1} s",
                at(0.5),
                at(0.9),
                errors.len(),
                fit.score,
                fit.score_before,
                if fit.is_trusted() { "trusted" } else { "not trusted" },
                circuit_words(fit.circuit.as_ref()),
                fit.tried
            );
            medians.push(at(0.5));
            ninetieths.push(at(0.9));
        }
        medians.sort_by(f64::total_cmp);
        ninetieths.sort_by(f64::total_cmp);
        println!("{count} presses, medians {medians:.1?} mm, 90th percentiles {ninetieths:.1?} mm");
    }
    Ok(())
}

/// The numbers below `count`, shuffled by `seed`.
fn shuffled(count: usize, seed: u64) -> Vec<usize> {
    let mut order: Vec<usize> = (0..count).collect();
    let mut state = 12345 + 7919 * seed;
    for i in (1..count).rev() {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        order.swap(i, (state >> 33) as usize % (i + 1));
    }
    order
}
