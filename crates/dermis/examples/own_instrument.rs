//! An instrument of your own: anything that delivers frames is a [`Source`]. This one stands for a board that hasn't
//! been built yet, and steps a skin's twin where yours would read its port.
//! `cargo run --release -p dermis --example own_instrument`

use std::time::Duration;

use dermis::pipeline::Prepared;
use dermis::source::{Counters, DeviceError, Frame, HostStamp, Layout, Source, SourceEvent};
use dermis::{Error, Pipeline, Session, Skin, Twin};

struct MyBoard {
    layout: Layout,
    twin: Twin,
    readings: Vec<f64>,
    frames: u64,
}

impl Source for MyBoard {
    fn layout(&self) -> &Layout {
        &self.layout
    }

    fn name(&self) -> &str {
        "my board"
    }

    fn next_frame(&mut self, frame: &mut Frame, _timeout: Duration) -> Result<SourceEvent, DeviceError> {
        let failed = |reason: String| DeviceError::SourceFailed { name: "my board".into(), reason };
        if self.frames == 40 {
            self.twin.scene_mut().press(1, 0.01, -0.02, 0.008, 80e3).map_err(|error| failed(error.to_string()))?;
        }
        let time_s = 0.02 * self.frames as f64;
        self.twin.step(time_s, &mut self.readings).map_err(|error| failed(error.to_string()))?;
        // Frames carry the board's own sequence number, which reveals lost frames, and are stamped on arrival.
        frame.refill(self.frames, HostStamp::now(), &self.readings, &[]);
        frame.device_time_ns = Some((1e9 * time_s) as u64);
        self.frames += 1;
        Ok(SourceEvent::Frame)
    }

    fn counters(&self) -> Counters {
        Counters { frames: self.frames, lost: 0, bad: 0 }
    }
}

/// Reads frames from a custom source.
pub fn main() -> Result<(), Error> {
    let skin = Skin::open("healing-square")?;
    let prepared = Prepared::new(skin.clone())?;
    let layout = Layout::Channels { count: prepared.channels() };
    let board = MyBoard { layout: layout.clone(), twin: Twin::from_skin(&skin)?, readings: Vec::new(), frames: 0 };
    let mut session = Session::of(Box::new(board), Pipeline::new(prepared, &layout, None)?);
    let last = session.by_ref().take(80).last().transpose()?;
    let touches = last.map_or(Vec::new(), |frame| frame.touches.into_owned());
    touches.iter().for_each(|touch| println!("touch at {:.4?} m", touch.position_m));
    assert_eq!(touches.len(), 1);
    Ok(())
}
