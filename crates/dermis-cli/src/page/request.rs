//! A page's command on its way to the pipeline, and the way back for the answer.

use dermis_page::Command;
use dermis_page::message::Answer;
use tokio::sync::mpsc;

/// A command with a way to answer it.
#[derive(Debug)]
pub struct Request {
    /// Number of the requesting page, for logs.
    pub client: u64,
    /// The command.
    pub command: Command,
    /// The reply; if it is dropped unanswered, the page shows nothing.
    pub reply: Reply,
}

/// Answers one request on the page that made it. Answering never blocks.
#[derive(Debug)]
pub struct Reply {
    pub(super) id: u64,
    pub(super) answers: Option<mpsc::Sender<Answer>>,
}

impl Reply {
    /// A reply without a reader, for requests that don't come from a page.
    pub fn unheard() -> Self {
        Self { id: 0, answers: None }
    }

    /// Reports success: `tared over 25 frames`.
    pub fn accept(self, text: impl Into<String>) {
        self.send(true, text.into());
    }

    /// Reports a refusal with its reason: `tare refused: a touch is on the skin`.
    pub fn refuse(self, text: impl Into<String>) {
        self.send(false, text.into());
    }

    fn send(self, ok: bool, text: String) {
        if let Some(answers) = self.answers {
            // If the page has left, or has this many unread answers, drop the answer.
            let _ = answers.try_send(Answer { id: self.id, ok, text });
        }
    }
}

/// The requests in order, without superseded ones: only the last hyperparameter and the last tare count. The senders of
/// the others get a reply.
pub fn coalesced(requests: impl IntoIterator<Item = Request>) -> Vec<Request> {
    let kind = |command: &Command| match command {
        Command::Hyperparameter(_) => Some((0, 0)),
        // A forced tare differs from an ordinary one.
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
    fn the_last_hyperparameter_of_a_burst_counts_and_recordings_keep_their_order() {
        let request = |command| Request { client: 1, command, reply: Reply::unheard() };
        let mut burst: Vec<Request> = (1..=300).map(|k| request(Command::Hyperparameter(f64::from(k)))).collect();
        burst.insert(100, request(Command::RecordStart));
        burst.insert(200, request(Command::RecordStop));
        let left: Vec<Command> = coalesced(burst).into_iter().map(|request| request.command).collect();
        assert_eq!(left, [Command::RecordStart, Command::RecordStop, Command::Hyperparameter(300.0)]);
    }
}
