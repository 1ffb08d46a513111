//! A command of a page on its way to the pipeline, and the answer's way back.

use dermis_page::Command;
use dermis_page::message::Answer;
use tokio::sync::mpsc;

/// A command with the way to answer it.
#[derive(Debug)]
pub struct Request {
    /// Number of the page that asks, for logs.
    pub client: u64,
    /// What is asked.
    pub command: Command,
    /// The way back; dropped without an answer, the page shows nothing.
    pub reply: Reply,
}

/// Answers one request in the page that made it. Answering never blocks.
#[derive(Debug)]
pub struct Reply {
    pub(super) id: u64,
    pub(super) answers: Option<mpsc::Sender<Answer>>,
}

impl Reply {
    /// A reply that nobody reads, for requests that come from elsewhere than a page.
    pub fn unheard() -> Self {
        Self { id: 0, answers: None }
    }

    /// Says that it was done: `tared over 25 frames`.
    pub fn accept(self, text: impl Into<String>) {
        self.send(true, text.into());
    }

    /// Says that it was not, and why: `tare refused: a touch is on the skin`.
    pub fn refuse(self, text: impl Into<String>) {
        self.send(false, text.into());
    }

    fn send(self, ok: bool, text: String) {
        if let Some(answers) = self.answers {
            // A page that went away, or that has this many answers unread, has nobody waiting for this one.
            let _ = answers.try_send(Answer { id: self.id, ok, text });
        }
    }
}

/// Requests in their order, without those that a later one of them makes pointless: of hyperparameters and
/// tares the last counts. Whoever asked for one of the others is told.
pub fn coalesced(requests: impl IntoIterator<Item = Request>) -> Vec<Request> {
    let kind = |command: &Command| match command {
        Command::Hyperparameter(_) => Some((0, 0)),
        // A tare that is forced is not the same as one that is not.
        Command::Tare { force } => Some((1, u8::from(*force))),
        _ => None,
    };
    let mut kept: Vec<Request> = Vec::new();
    for request in requests {
        let same = kind(&request.command).and_then(|new| kept.iter().position(|old| kind(&old.command) == Some(new)));
        if let Some(index) = same {
            kept.remove(index).reply.accept("replaced by a later one");
        }
        kept.push(request);
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_a_burst_the_last_hyperparameter_counts_and_recordings_keep_their_order() {
        let request = |command| Request { client: 1, command, reply: Reply::unheard() };
        let mut burst: Vec<Request> = (1..=300).map(|k| request(Command::Hyperparameter(f64::from(k)))).collect();
        burst.insert(100, request(Command::RecordStart));
        burst.insert(200, request(Command::RecordStop));
        let left: Vec<Command> = coalesced(burst).into_iter().map(|request| request.command).collect();
        assert_eq!(left, [Command::RecordStart, Command::RecordStop, Command::Hyperparameter(300.0)]);
    }
}
