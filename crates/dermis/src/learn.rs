//! Networks that label the pixels of images: training sets, training, use. `examples/train_and_use.rs` does all three.

/// ```
/// use dermis::Skin;
/// use dermis::learn::{SimulatedFrames, TrainSetRequest};
/// use dermis::pipeline::Prepared;
/// use dermis::skin::{Layer, SheetLayer};
///
/// let mut skin = Skin::disc("my-disc", 100.0, Layer::Sheet(SheetLayer::gel(5.0, 0.2))).with_rim_electrodes(12, 8.0);
/// (skin.imaging.grid, skin.imaging.elements) = (16, 700);
/// let request = TrainSetRequest::new(skin.clone(), 24);
/// // Frames of skins that deviate slightly from the model, with the class of every pixel.
/// let simulated = SimulatedFrames::new(&request, &Prepared::new(skin)?, 99, 2)?;
/// assert_eq!(simulated.frames.len(), 2);
/// # Ok::<(), dermis::Error>(())
/// ```
pub use dermis_lab::learning::train_set::SimulatedFrames;
/// Shown with [`SimulatedFrames`].
pub use dermis_lab::learning::train_set::TrainSetRequest;
/// No example: simulating a set takes a few seconds, see `examples/train_and_use.rs`.
pub use dermis_lab::learning::train_set::simulate;

/// Shown with [`Segmenter`].
pub use dermis_lab::learning::segment::Method;
/// No example: a frame labelled by [`Segmenter`], which has one.
pub use dermis_lab::learning::segment::Segmented;
/// ```
/// use dermis::Skin;
/// use dermis::learn::{Method, Segmenter};
/// use dermis::offline::Reference;
/// use dermis::pipeline::Prepared;
///
/// let prepared = Prepared::new(Skin::open("healing-square")?)?;
/// let rest = vec![prepared.voltages.clone(); 2];
/// let reference = Reference::of(&prepared, &rest)?;
/// // Without a network, thresholds label the image.
/// let mut segmenter = Segmenter::new(&prepared, &reference, None, 32)?;
/// let labelled = segmenter.label(&[reference.difference(&rest[0], None)], |_done, _all| {})?;
/// assert_eq!(labelled[0].method, Method::Thresholds);
/// # Ok::<(), dermis::Error>(())
/// ```
pub use dermis_lab::learning::segment::Segmenter;

/// Shown with [`built_in`].
pub use dermis_live::network::CLASSES;
/// ```
/// use dermis::learn::{CLASSES, built_in};
///
/// assert_eq!(CLASSES, ["background", "lowered", "raised"]);
/// // The network that comes with a skin, if there is one.
/// let model = built_in("healing-square")?;
/// println!("{}", if model.is_some() { "built in" } else { "none" });
/// # Ok::<(), dermis::Error>(())
/// ```
pub use dermis_live::network::built_in;

/// No example: training takes at least a few seconds, see `examples/train_and_use.rs`.
pub use dermis_learn::{
    Model, TrainingSet,
    train::{Progress, TrainOptions, Training, train},
};
