//! Writes the disc of the benches as JSON, so that other programs can be compared on the same mesh: nodes (m),
//! elements, the rim edges of every electrode, contact impedance (ohm.m), stimulations (A) and measurements, and the
//! voltages (V) computed by dermis for unit sheet conductance.
//!
//! `cargo run --release -p dermis-tomo --example peer_case -- 5000 case.json`

use dermis_tomo::eit::{Drive, Driven, ForwardModel, Measure, Order, Pattern, Protocol, ProtocolSpec};
use dermis_tomo::mesh::{Contact, Direction, Outline, SheetSpec};
use serde_json::{Value, json};

const ELECTRODES: usize = 16;

fn dense(pattern: &Pattern) -> Vec<f64> {
    let mut row = vec![0.0; ELECTRODES];
    for &(electrode, weight) in pattern.entries() {
        row[electrode as usize] = weight;
    }
    row
}

fn case(elements: usize) -> Result<Value, Box<dyn std::error::Error>> {
    let arcs = Outline::rim_arcs(ELECTRODES, 0.01, 0.0, Direction::CounterClockwise);
    let spec = SheetSpec::new(Outline::Disc { radius_m: 0.1 }, arcs, 3e-3).with_target_elements(elements)?;
    let (body, _) = spec.build(&[1e-3])?;
    let protocol = Protocol::generate(&ProtocolSpec {
        electrode_count: ELECTRODES,
        drive: Drive::Adjacent,
        measure: Measure::Adjacent,
        order: Order::Absolute,
        driven: Driven::Drop,
        amplitude_a: 1e-3,
    })?;
    let model = ForwardModel::new(body, protocol)?;
    let (mesh, protocol) = (&model.body().mesh, model.protocol());
    let voltages = model.solve(&vec![1.0; mesh.element_count()])?.voltages();
    let faces = |contact: &Contact| match contact {
        Contact::Faces(faces) => faces.clone(),
        _ => Vec::new(),
    };
    Ok(json!({
        "nodes": mesh.nodes().iter().map(|node| [node[0], node[1]]).collect::<Vec<_>>(),
        "elements": mesh.elements().map(<[u32]>::to_vec).collect::<Vec<_>>(),
        "electrodes": model.body().electrodes.iter().map(|e| faces(&e.contact)).collect::<Vec<_>>(),
        "contact_impedance_ohm_m": 1e-3,
        "stimulations": protocol.stimulations().iter().map(dense).collect::<Vec<_>>(),
        "measurements": (0..protocol.channel_count()).map(|c| dense(protocol.pattern_of(c))).collect::<Vec<_>>(),
        "stimulation_of": protocol.measurements().iter().map(|m| m.stimulation).collect::<Vec<_>>(),
        "voltages_v": voltages,
    }))
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [elements, path] = arguments.as_slice() else {
        return Err("usage: peer_case ELEMENTS FILE".into());
    };
    std::fs::write(path, case(elements.parse()?)?.to_string())?;
    Ok(())
}
