//! The second step of imaging: a network's input images of a frame ([`FirstStep`]), and the classes of live frames
//! ([`Classifier`]).

mod built_in;
mod classes;
mod classifier;
mod contact_image;
mod first_network;
mod input_image;
mod masks;
mod network_input;
mod plain_images;

pub use built_in::built_in;
pub use classes::{CLASSES, Classes, UNLIKE};
pub use classifier::{Classifier, Seen, imaging_sha256, suits};
pub use contact_image::{FittedTouches, draw_discs};
pub use input_image::InputImage;
pub use masks::{MaskRule, PRESENCE, PresenceRule, enlarge, masks_of_image};
pub use network_input::FirstStep;
pub use plain_images::BATCH;
