//! One connected page. It gets the scene first, then always the newest update; its requests go to the pipeline.
//!
//! A page acknowledges each update. At most [`WINDOW`] updates are in flight, so a slow page or network gets fewer
//! updates rather than old ones: missed updates are counted, and nothing queues up.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use axum::body::Bytes;
use axum::extract::ws::{CloseFrame, Message, WebSocket, close_code};
use crossbeam_channel::TrySendError;
use dermis_page::message::{Answer, Level, Notice};
use dermis_page::protocol::{self, PageMessage};
use dermis_page::{BodyCommand, Command, PatchCommand};
use tokio::sync::{broadcast, mpsc, watch};
use tokio::time::{Instant, MissedTickBehavior, interval, sleep, timeout};

use super::endpoint::{Endpoint, Packet, SkinPage};
use super::request::{Reply, Request};
use super::shared::Shared;

/// Updates sent and not yet acknowledged: enough for 60 per second over a round trip of 130 ms.
const WINDOW: u64 = 8;
/// Answers queued for one page.
const ANSWER_BACKLOG: usize = 64;
/// Disconnect a page that accepts nothing for this long.
const SEND_LIMIT: Duration = Duration::from_secs(10);
const ALIVE_PERIOD: Duration = Duration::from_secs(1);
const RELEASE_LIMIT: Duration = Duration::from_secs(10);
/// Interval for retrying a request when the pipeline's queue is full.
const RETRY: Duration = Duration::from_millis(5);

/// Reason for the end of a page's connection.
enum End {
    /// The page or the network has gone.
    Gone,
    /// The server closes it, with this code and reason.
    Closed(u16, &'static str),
}

struct Client<'a> {
    socket: WebSocket,
    shared: &'a Shared,
    endpoint: &'a Endpoint,
    number: u64,
    answers: mpsc::Sender<Answer>,
    /// Current presses: number of the skin, and pointer.
    held: BTreeSet<(usize, u64)>,
    /// The last requested hyperparameter and its skin, while that pipeline's queue has no room for it.
    later: Option<(usize, Request)>,
    /// Version of the last message sent in each slot.
    versions: BTreeMap<usize, u64>,
    allowance: Allowance,
    /// Allowance for acknowledgements and pings.
    signs: Allowance,
    sent: u64,
    acknowledged: u64,
    missed: u64,
}

/// A token bucket that fills at the allowed rate and holds one second's worth.
struct Allowance {
    per_s: f64,
    left: f64,
    filled: Instant,
}

/// Serves one page until it leaves or the server stops.
pub(super) async fn serve(mut socket: WebSocket, shared: &Shared, endpoint: &Endpoint) {
    let Ok(_place) = shared.places.try_acquire() else {
        return close(&mut socket, close_code::AGAIN, "too many pages are open: close one").await;
    };
    let (answers, unsent) = mpsc::channel(ANSWER_BACKLOG);
    let mut client = Client {
        socket,
        shared,
        endpoint,
        number: shared.next_client.fetch_add(1, Ordering::Relaxed),
        answers,
        held: BTreeSet::new(),
        later: None,
        versions: BTreeMap::new(),
        allowance: Allowance::new(shared.options.most_messages_per_s),
        signs: Allowance::new(shared.options.most_messages_per_s),
        sent: 0,
        acknowledged: 0,
        missed: 0,
    };
    let count = &endpoint.hub.inner.counts.clients;
    count.fetch_add(1, Ordering::Relaxed);
    let end = client.talk(unsent).await;
    count.fetch_sub(1, Ordering::Relaxed);
    if let Err(End::Closed(code, reason)) = end {
        close(&mut client.socket, code, reason).await;
    }
    client.release_all().await;
}

impl Client<'_> {
    /// Passes messages both ways until the connection ends.
    async fn talk(&mut self, mut answers: mpsc::Receiver<Answer>) -> Result<(), End> {
        let shared = self.shared;
        let mut stop = shared.stop.clone();
        let Endpoint { hub, updates, scene_json, .. } = self.endpoint;
        let mut notices = hub.inner.notices.subscribe();
        let mut noise = hub.inner.noise.subscribe();
        let mut updates = updates.subscribe();
        let mut alive = interval(ALIVE_PERIOD);
        let mut retry = interval(RETRY);
        retry.set_missed_tick_behavior(MissedTickBehavior::Delay);
        noise.mark_changed();
        updates.mark_changed();
        self.send_text(scene_json.clone()).await?;
        // An update published while no page was open is still waiting.
        hub.inner.published.notify_one();
        loop {
            let is_ready = self.sent - self.acknowledged < WINDOW;
            tokio::select! {
                () = stopped(&mut stop) => {
                    let reason = shared.farewell.get().copied().unwrap_or("dermis ended");
                    return Err(End::Closed(close_code::AWAY, reason));
                }
                message = self.socket.recv() => self.receive(message)?,
                Some(answer) = answers.recv() => self.send_text(protocol::answer(&answer)).await?,
                notice = notices.recv() => self.send_notice(notice).await?,
                Ok(()) = noise.changed() => {
                    let message = protocol::noise(&noise.borrow_and_update().clone());
                    self.send_binary(message).await?;
                }
                Ok(()) = updates.changed(), if is_ready => {
                    let update = updates.borrow_and_update().clone();
                    if let Some(update) = update {
                        self.send_update(&update).await?;
                    }
                }
                _ = retry.tick(), if self.later.is_some() => self.try_again(),
                _ = alive.tick() => self.send_text(protocol::alive(self.missed, hub.stats())).await?,
            }
        }
    }

    async fn send_update(&mut self, update: &Arc<Packet>) -> Result<(), End> {
        if self.sent > 0 {
            let missed = update.sequence.saturating_sub(self.sent + 1);
            self.missed += missed;
            self.endpoint.hub.inner.counts.dropped.fetch_add(missed, Ordering::Relaxed);
        } else {
            self.acknowledged = update.sequence - 1;
        }
        self.sent = update.sequence;
        for part in &update.parts {
            if self.versions.insert(part.slot, part.version) != Some(part.version) {
                self.send_binary(part.message.clone()).await?;
            }
        }
        self.send_text(update.state.clone()).await
    }

    async fn send_notice(&mut self, notice: Result<Notice, broadcast::error::RecvError>) -> Result<(), End> {
        let notice = match notice {
            Ok(notice) => notice,
            Err(broadcast::error::RecvError::Lagged(count)) => {
                Notice { level: Level::Warning, text: format!("{count} notices were lost: this page was too slow") }
            }
            Err(broadcast::error::RecvError::Closed) => return Err(End::Gone),
        };
        self.send_text(protocol::notice(&notice)).await
    }

    fn receive(&mut self, message: Option<Result<Message, axum::Error>>) -> Result<(), End> {
        let text = match message {
            Some(Ok(Message::Text(text))) => text,
            Some(Ok(Message::Binary(_))) => return Err(End::Closed(close_code::UNSUPPORTED, "expected text messages")),
            Some(Ok(Message::Ping(_) | Message::Pong(_))) => return self.count_sign(),
            Some(Ok(Message::Close(_))) | None => return Err(End::Gone),
            Some(Err(error)) => return Err(unreadable(&error)),
        };
        let said = match &self.endpoint.body {
            Some(_) => protocol::parse::<BodyCommand>(&text),
            None => protocol::parse::<Command>(&text).map(|said| said.map(to_only_skin)),
        };
        match said {
            Ok(PageMessage::Acknowledge(sequence)) => {
                self.acknowledged = sequence.clamp(self.acknowledged, self.sent);
                return self.count_sign();
            }
            _ if !self.allowance.spend() => {
                return Err(End::Closed(close_code::POLICY, "too many messages per second"));
            }
            Ok(PageMessage::Ask(id, BodyCommand::Patch(PatchCommand { number, command }))) => {
                match self.endpoint.skins.get(number) {
                    Some(Some(skin)) => self.pass_on(id, number, skin, command),
                    Some(None) => self.answer(id, format!("refused: patch {number} is not running")),
                    None => {
                        let expected = self.endpoint.skins.len();
                        self.answer(id, format!("patch {number} refused: expected a number below {expected}"));
                    }
                }
            }
            Ok(PageMessage::Ask(id, BodyCommand::Joints(values))) => {
                let set = self.endpoint.body.as_ref().map(|body| body.set_joints(&values));
                if let Some(Err(refusal)) = set {
                    self.answer(id, refusal);
                }
            }
            Err((id, text)) => self.answer(id, text),
        }
        Ok(())
    }

    /// Acknowledgements and pings have their own allowance: a page may acknowledge every update, but send no more of
    /// them than of other messages.
    fn count_sign(&mut self) -> Result<(), End> {
        match self.signs.spend() {
            true => Ok(()),
            false => Err(End::Closed(close_code::POLICY, "too many acknowledgements or pings per second")),
        }
    }

    /// Checks a command and hands it to the pipeline, or replies with the reason for refusing it.
    fn pass_on(&mut self, id: u64, number: usize, skin: &SkinPage, mut command: Command) {
        if let Err(refusal) = command.check(&skin.scene).and_then(|()| self.own(number, &mut command)) {
            return self.answer(id, refusal);
        }
        let held = match &command {
            Command::Press(press) => Some((press.pointer_id, true)),
            Command::Release { pointer_id } => Some((*pointer_id, false)),
            _ => None,
        };
        let reply = Reply { id, answers: Some(self.answers.clone()) };
        let request = Request { client: self.number, command, reply };
        if self.later.is_some() && matches!(request.command, Command::Hyperparameter(_)) {
            return self.keep_for_later(number, request);
        }
        match skin.commands.try_send(request) {
            Ok(()) => match held {
                Some((pointer, true)) => _ = self.held.insert((number, pointer)),
                Some((pointer, false)) => _ = self.held.remove(&(number, pointer)),
                None => {}
            },
            Err(TrySendError::Full(request)) if matches!(request.command, Command::Hyperparameter(_)) => {
                self.keep_for_later(number, request);
            }
            Err(TrySendError::Full(request)) => {
                request.reply.refuse("the pipeline is busy: nothing was done, try again");
                // The page has released its press and won't repeat it.
                if let Some((pointer, false)) = held {
                    self.held.remove(&(number, pointer));
                    tokio::spawn(release(skin.commands.clone(), self.number, pointer));
                }
            }
            Err(TrySendError::Disconnected(request)) => request.reply.refuse("the pipeline has ended"),
        }
    }

    /// Keeps the latest hyperparameter until there is room for it.
    fn keep_for_later(&mut self, number: usize, request: Request) {
        if let Some((_, earlier)) = self.later.replace((number, request)) {
            earlier.reply.accept("replaced by a later one");
        }
    }

    fn try_again(&mut self) {
        let Some((number, request)) = self.later.take() else { return };
        let Some(Some(skin)) = self.endpoint.skins.get(number) else { return };
        match skin.commands.try_send(request) {
            Ok(()) => {}
            Err(TrySendError::Full(request)) => self.later = Some((number, request)),
            Err(TrySendError::Disconnected(request)) => request.reply.refuse("the pipeline has ended"),
        }
    }

    /// Makes pointer ids unique among pages, and lets a page move only its own presses.
    fn own(&self, skin: usize, command: &mut Command) -> Result<(), String> {
        let (pointer, is_new) = match command {
            Command::Press(press) => (&mut press.pointer_id, true),
            Command::Move(press) => (&mut press.pointer_id, false),
            Command::Release { pointer_id } => (pointer_id, false),
            _ => return Ok(()),
        };
        let Ok(number) = u32::try_from(*pointer) else {
            return Err(format!("pointer_id {pointer} refused: expected at most {}", u32::MAX));
        };
        *pointer = (self.number << 32) | u64::from(number);
        match self.held.contains(&(skin, *pointer)) {
            true if is_new => Err(format!("press refused: pointer_id {number} is already pressing")),
            false if !is_new => Err(format!("pointer_id {number} refused: it is not pressing")),
            false if self.held.len() >= Command::MOST_PRESSES => {
                Err(format!("press refused: expected at most {} at once", Command::MOST_PRESSES))
            }
            _ => Ok(()),
        }
    }

    /// Ends the presses that a page still held when it left.
    async fn release_all(&mut self) {
        for (number, pointer_id) in std::mem::take(&mut self.held) {
            if let Some(Some(skin)) = self.endpoint.skins.get(number) {
                release(skin.commands.clone(), self.number, pointer_id).await;
            }
        }
    }

    fn answer(&self, id: u64, text: String) {
        // Dropped if the page has too many unread answers.
        let _ = self.answers.try_send(Answer { id, ok: false, text });
    }

    async fn send_text(&mut self, text: String) -> Result<(), End> {
        self.send(Message::Text(text.into())).await
    }

    async fn send_binary(&mut self, bytes: Bytes) -> Result<(), End> {
        self.send(Message::Binary(bytes)).await
    }

    async fn send(&mut self, message: Message) -> Result<(), End> {
        match timeout(SEND_LIMIT, self.socket.send(message)).await {
            Ok(Ok(())) => Ok(()),
            Ok(Err(_)) | Err(_) => Err(End::Gone),
        }
    }
}

impl Allowance {
    fn new(per_s: u32) -> Self {
        let per_s = f64::from(per_s);
        Self { per_s, left: per_s, filled: Instant::now() }
    }

    /// Spends one message's worth, if available.
    fn spend(&mut self) -> bool {
        let now = Instant::now();
        let gained = (now - self.filled).as_secs_f64() * self.per_s;
        self.left = (self.left + gained).min(self.per_s);
        self.filled = now;
        let is_enough = self.left >= 1.0;
        self.left -= if is_enough { 1.0 } else { 0.0 };
        is_enough
    }
}

/// A command from a single skin's page, whose endpoint has only that skin.
fn to_only_skin(command: Command) -> BodyCommand {
    BodyCommand::Patch(PatchCommand { number: 0, command })
}

/// Returns when the server stops.
pub(super) async fn stopped(stop: &mut watch::Receiver<bool>) {
    // An error means that the handle has been dropped, which stops the server too.
    let _ = stop.wait_for(|&is_stopped| is_stopped).await;
}

/// Delivers a release. If it got lost, the press would stay on the skin for good.
async fn release(commands: crossbeam_channel::Sender<Request>, client: u64, pointer_id: u64) {
    let deadline = Instant::now() + RELEASE_LIMIT;
    let mut request = Request { client, command: Command::Release { pointer_id }, reply: Reply::unheard() };
    loop {
        request = match commands.try_send(request) {
            Ok(()) | Err(TrySendError::Disconnected(_)) => return,
            Err(TrySendError::Full(request)) => request,
        };
        if Instant::now() > deadline {
            return tracing::error!(
                "press {pointer_id} was not released: the pipeline took no command for {RELEASE_LIMIT:?}"
            );
        }
        sleep(Duration::from_millis(5)).await;
    }
}

/// The reason why a message could not be read: too long, or not a WebSocket message.
fn unreadable(error: &axum::Error) -> End {
    if error.to_string().contains("too long") {
        return End::Closed(close_code::SIZE, "message too long");
    }
    End::Gone
}

async fn close(socket: &mut WebSocket, code: u16, reason: &'static str) {
    let frame = CloseFrame { code, reason: reason.into() };
    // The page may have gone already, so ignore errors.
    let _ = timeout(Duration::from_secs(1), socket.send(Message::Close(Some(frame)))).await;
}
