//! The resistance backend with the physics of paper P's disc: the firmware's own bytes, through the host's own
//! decoder and the whole pipeline, give the touch at the pressed position.

mod bench;

use bench::{Analog, Bench, Pause, Shared, Spi, Wires, chips};
use dermis_device::instruments::wire::Order;
use dermis_device::{Layout, Status};
use dermis_firmware::mux64::{Mux64, STEP_A, Selection};
use dermis_lab::measured_list::measured_list;
use dermis_live::pipeline::Pipeline;
use dermis_live::prepare::Prepared;
use dermis_skin::Skin;
use dermis_twin::from_skin::patched_options;
use dermis_twin::mechanics::Indenter;
use dermis_twin::{Frontend, PatchedSkin};

/// Resistance of the multiplexer's ground switch, ohms, from the paper.
const SWITCH_OHM: f64 = 400.0;
/// Noise at the converter, volts, as in the twin of these skins.
const NOISE_V: f64 = 20e-6;

/// Sheet and patches, as impedances between the electrodes.
struct Sheet {
    skin: PatchedSkin,
    /// Potential of the row's electrode for 1 A into the column's electrode and out of the last one, ohms.
    ohm: Vec<[f64; 64]>,
}

impl Sheet {
    fn new() -> Self {
        let file = Skin::open("piezo-disc").expect("a built-in skin");
        let skin = PatchedSkin::new(patched_options(&file).expect("patches")).expect("the twin's own skin");
        let mut sheet = Self { skin, ohm: vec![[0.0; 64]; 64] };
        sheet.press(&[]);
        sheet
    }

    fn press(&mut self, indenters: &[Indenter]) {
        let mut readings = vec![0.0; self.skin.channel_count()];
        self.skin.voltages(indenters, 0.1, &mut readings).expect("it is solved");
        let contact = self.skin.contact_s_per_m2().to_vec();
        let mut sheet = self.skin.sheet().clone();
        let impedance = sheet.impedance(&contact).expect("it is solved");
        for (row, ohm) in self.ohm.iter_mut().enumerate() {
            *ohm = std::array::from_fn(|column| impedance[(row, column)]);
        }
    }
}

impl Analog for Sheet {
    /// The current returns through the ground switch, which raises the potential of the sink's electrode.
    fn outputs_v(&mut self, Selection { steps, lines }: Selection) -> [f64; 2] {
        let [source, sink, positive, negative] = lines.map(usize::from);
        let current_a = f64::from(steps) * f64::from(STEP_A);
        let potential_v = |electrode: usize| match (electrode, source, sink) {
            (0..64, 0..64, 0..64) => {
                let by_v = |from: usize| current_a * (self.ohm[from][source] - self.ohm[from][sink]);
                by_v(electrode) - by_v(sink) + current_a * SWITCH_OHM
            }
            _ => 0.0,
        };
        [potential_v(positive), potential_v(negative)]
    }
}

fn board(chips: &Shared<Sheet>) -> Mux64<Spi<Sheet>, Wires<Sheet>, Pause<Sheet>> {
    chips.borrow_mut().noise_v = NOISE_V;
    Mux64::new(Spi(chips.clone()), Wires(chips.clone()), Pause(chips.clone()), 64).expect("the converter answers")
}

#[test]
fn the_firmwares_bytes_give_the_touch_at_the_press() {
    let mut skin = Skin::open("piezo-disc").expect("a built-in skin");
    // Coarser images than the file's 32 pixels per side, which halves the time for the operator.
    skin.imaging.grid = 24;
    let list = measured_list(&skin.protocol().expect("a protocol")).expect("four electrodes a channel");
    let setup = vec![Order::Protocol(list), Order::AmplitudeA((skin.backend.current_ma * 1e-3) as f32)];
    let prepared = Prepared::new(skin).expect("it can be prepared");
    let mut pipeline = Pipeline::new(prepared, &Layout::Channels { count: 4096 }, None).expect("a pipeline");

    let chips = chips(Sheet::new());
    let board = board(&chips);
    let mut bench = Bench::new(chips.clone(), board, setup, true);
    let mut slowest_s = 0.0_f64;
    let mut touches = Vec::new();
    let places_mm = [[-21.0, 14.0], [8.0, -33.0], [0.0, 3.0]];
    let mut errors_mm = Vec::new();
    // The range settles in the first frames; the next 32 make the baseline.
    for n in 0..39 {
        let (frame, took_s) = bench.frame();
        assert_eq!((frame.values.len(), frame.channel_times_ns.len()), (4096, 4096));
        slowest_s = slowest_s.max(took_s);
        if n >= 6 {
            assert!(!frame.status.has(Status::SATURATED) && !frame.status.has(Status::COMPLIANCE), "frame {n}");
            pipeline.process(&frame, frame.host_monotonic_ns).expect("a frame of this skin");
        }
    }
    assert!(pipeline.reference().is_some(), "32 frames make the baseline");
    for [x_mm, y_mm] in places_mm {
        chips.borrow_mut().analog.press(&[Indenter::disc([x_mm * 1e-3, y_mm * 1e-3], 0.011, 5e3)]);
        for _ in 0..4 {
            let (frame, _) = bench.frame();
            let output = pipeline.process(&frame, frame.host_monotonic_ns).expect("a frame of this skin");
            touches = output.touches.to_vec();
        }
        assert_eq!(touches.len(), 1, "pressed at {x_mm} {y_mm} mm: {touches:?}");
        let [x_m, y_m] = touches[0].position_m;
        errors_mm.push((x_m * 1e3 - x_mm).hypot(y_m * 1e3 - y_mm));
        chips.borrow_mut().analog.press(&[]);
        for _ in 0..4 {
            let (frame, _) = bench.frame();
            let output = pipeline.process(&frame, frame.host_monotonic_ns).expect("a frame of this skin");
            touches = output.touches.to_vec();
        }
        assert!(touches.is_empty(), "released, and still {touches:?}");
    }
    println!("frames of {slowest_s:.2} s; touches {errors_mm:.2?} mm off");
    assert_eq!(bench.inbox.losses(), (0, 0));
    // The error bound of the same skin's twin. Patches are shorted as a whole, so their pitch of 10 mm shows.
    assert!(errors_mm.iter().all(|error| *error < 6.0), "{errors_mm:?} mm");
}
