//! Runs a network on an image, for comparison with other programs:
//! `run_network WEIGHTS INPUTS CLASSES WIDTH LEVELS ROWS COLUMNS IN OUT COPY`. IN is inputs x rows x columns and OUT
//! classes x rows x columns of little-endian 32-bit floats; COPY receives the weights as written by this library.

use std::error::Error;
use std::path::Path;

use dermis_learn::{Network, Tensors, UNetShape};

fn main() -> Result<(), Box<dyn Error>> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let [weights, inputs, classes, width, levels, rows, columns, input, output, copy] = words.as_slice() else {
        return Err("expected WEIGHTS INPUTS CLASSES WIDTH LEVELS ROWS COLUMNS IN OUT COPY".into());
    };
    let shape = UNetShape {
        inputs: inputs.parse()?,
        classes: classes.parse()?,
        width: width.parse()?,
        levels: levels.parse()?,
    };
    let (rows, columns): (usize, usize) = (rows.parse()?, columns.parse()?);
    let tensors = Tensors::from_bytes(&std::fs::read(weights)?, Path::new(weights))?;
    let mut network = Network::new(shape, &tensors, rows, columns)?;
    let image: Vec<f32> =
        std::fs::read(input)?.as_chunks::<4>().0.iter().map(|four| f32::from_le_bytes(*four)).collect();
    let mut logits = vec![0.0; shape.classes * rows * columns];
    network.logits(&image, &mut logits)?;
    std::fs::write(output, logits.iter().flat_map(|value| value.to_le_bytes()).collect::<Vec<u8>>())?;
    std::fs::write(copy, tensors.to_bytes()?)?;
    Ok(())
}
