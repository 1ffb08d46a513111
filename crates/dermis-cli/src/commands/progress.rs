//! Progress messages of commands.

use std::io::IsTerminal;

/// Shorter work needs no message.
const QUIET: std::time::Duration = std::time::Duration::from_secs(2);

/// Work of unknown length. A terminal shows a spinner; otherwise a line on stderr appears if it takes longer than two
/// seconds.
pub(crate) struct Busy {
    spinner: indicatif::ProgressBar,
    done: Option<crossbeam_channel::Sender<()>>,
}

/// Shows what is being done until the returned value is dropped.
pub(crate) fn busy(text: String) -> Busy {
    let spinner = spinner(&text);
    let (done, wait) = crossbeam_channel::bounded(1);
    if !std::io::stderr().is_terminal() {
        std::thread::spawn(move || {
            if wait.recv_timeout(QUIET) == Err(crossbeam_channel::RecvTimeoutError::Timeout) {
                eprintln!("{text} ...");
            }
        });
    }
    Busy { spinner, done: Some(done) }
}

impl Busy {
    /// Ends the display.
    pub(crate) fn finish(self) {}
}

impl Drop for Busy {
    fn drop(&mut self) {
        self.done = None;
        self.spinner.finish_and_clear();
    }
}

/// Runs work that reports its progress in parts, with a bar on stderr meanwhile.
pub(crate) fn with_progress<T>(unit: &str, work: impl FnOnce(&mut dyn FnMut(usize, usize)) -> T) -> T {
    let bar = progress_bar(unit);
    let done = work(&mut |done, all| {
        bar.set_length(all as u64);
        bar.set_position(done as u64);
    });
    bar.finish_and_clear();
    done
}

/// A progress bar on stderr, shown only on a terminal.
pub(crate) fn progress_bar(unit: &str) -> indicatif::ProgressBar {
    let style = indicatif::ProgressStyle::with_template(&format!("{{bar:40}} {{pos}}/{{len}} {unit}, {{eta}} left"));
    let bar = indicatif::ProgressBar::new(0);
    bar.set_style(style.unwrap_or_else(|_| indicatif::ProgressStyle::default_bar()));
    bar
}

/// A spinner on stderr for work of unknown length.
pub(crate) fn spinner(text: &str) -> indicatif::ProgressBar {
    let spinner = indicatif::ProgressBar::new_spinner().with_message(text.to_string());
    spinner.enable_steady_tick(std::time::Duration::from_millis(120));
    spinner
}
