//! The server's parameters. A viewer can read all of them and set a few. Limits of the guard are read-only, because
//! clients need no token.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use ::foxglove::WebSocketServerHandle;
use ::foxglove::websocket::{AnyClient, GetParametersResponder, Parameter, ParameterHandler, SetParametersResponder};
use ::foxglove::websocket::{ParameterValue, Status};
use crossbeam_channel::Sender;
use dermis_skin::GuardSettings;

use crate::{LiveCommand, LiveRequest};

/// The requester, as recorded.
pub(super) const ASKED: &str = "requested in Foxglove";

/// Last part of the name of the parameter that can be set.
pub(super) const HYPERPARAMETER: &str = "hyperparameter";

/// The running server; `None` once it has stopped.
#[derive(Default)]
pub(super) struct Running(Mutex<Option<WebSocketServerHandle>>);

impl Running {
    pub(super) fn set(&self, handle: WebSocketServerHandle) {
        *self.lock() = Some(handle);
    }

    pub(super) fn take(&self) -> Option<WebSocketServerHandle> {
        self.lock().take()
    }

    /// Calls `with` if the server runs.
    pub(super) fn with<T>(&self, with: impl FnOnce(&WebSocketServerHandle) -> T) -> Option<T> {
        self.lock().as_ref().map(with)
    }

    /// Shows a warning in place of an earlier one with the same id.
    pub(super) fn warn(&self, id: &str, text: String) {
        self.with(|handle| handle.publish_status(Status::warning(text).with_id(id)));
    }

    fn lock(&self) -> MutexGuard<'_, Option<WebSocketServerHandle>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[derive(Default)]
struct Known {
    values: BTreeMap<String, Parameter>,
    /// Parameters that can be set, and the pipelines that set them.
    settable: BTreeMap<String, Sender<LiveRequest>>,
}

/// The parameters of all patches.
#[derive(Clone, Default)]
pub(super) struct Parameters {
    known: Arc<Mutex<Known>>,
    server: Arc<Running>,
}

impl Parameters {
    pub(super) fn new(server: Arc<Running>) -> Self {
        Self { known: Arc::default(), server }
    }

    /// Sets values and tells the clients that have subscribed to them.
    pub(super) fn publish(&self, parameters: Vec<Parameter>) {
        let mut known = self.lock();
        for parameter in &parameters {
            known.values.insert(parameter.name.clone(), parameter.clone());
        }
        drop(known);
        self.server.with(|handle| handle.publish_parameter_values(parameters));
    }

    /// Lets clients set a parameter through a pipeline.
    pub(super) fn allow(&self, name: String, requests: Sender<LiveRequest>) {
        self.lock().settable.insert(name, requests);
    }

    /// The parameters with these names, or all.
    fn of(&self, names: &[String]) -> Vec<Parameter> {
        let known = self.lock();
        match names {
            [] => known.values.values().cloned().collect(),
            _ => names.iter().filter_map(|name| known.values.get(name).cloned()).collect(),
        }
    }

    /// The command behind a new value, and the pipeline to ask.
    fn command(&self, parameter: &Parameter) -> Result<(LiveCommand, Sender<LiveRequest>), String> {
        let name = &parameter.name;
        let known = self.lock();
        let Some(requests) = known.settable.get(name) else {
            return Err(match known.values.contains_key(name) {
                true => format!("{name}: read-only; limits and other settings are in the skin file"),
                false => format!("{name}: unknown parameter"),
            });
        };
        let value = match parameter.value {
            Some(ParameterValue::Float64(value)) => value,
            Some(ParameterValue::Integer(value)) => value as f64,
            _ => return Err(format!("{name}: expected a number")),
        };
        Ok((LiveCommand::Hyperparameter(value), requests.clone()))
    }

    fn lock(&self) -> MutexGuard<'_, Known> {
        self.known.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl ParameterHandler for Parameters {
    fn get(&self, _: AnyClient, names: Vec<String>, _: Option<String>, responder: GetParametersResponder) {
        responder.respond(self.of(&names));
    }

    fn set(&self, client: AnyClient, wanted: Vec<Parameter>, _: Option<String>, responder: SetParametersResponder) {
        let names = wanted.iter().map(|parameter| parameter.name.clone()).collect();
        // Answers with the values in use once the last request has been carried out or refused.
        let reply = Arc::new(Reply { parameters: self.clone(), names, responder: Mutex::new(Some(responder)) });
        for parameter in wanted {
            let (command, requests) = match self.command(&parameter) {
                Ok(found) => found,
                Err(reason) => {
                    client.send_warning(reason);
                    continue;
                }
            };
            let (reply, client, parameters) = (reply.clone(), client.clone(), self.clone());
            let request = LiveRequest::new(command, ASKED, move |done| {
                match done {
                    Ok(_) => parameters.publish(vec![parameter]),
                    Err(reason) => client.send_warning(reason),
                }
                drop(reply);
            });
            if let Err(refused) = requests.try_send(request) {
                refused.into_inner().refuse("too many requests at once");
            }
        }
    }
}

/// The reply to a client that sets parameters; sent when the last request that holds it is done.
struct Reply {
    parameters: Parameters,
    names: Vec<String>,
    responder: Mutex<Option<SetParametersResponder>>,
}

impl Drop for Reply {
    fn drop(&mut self) {
        let responder = self.responder.get_mut().unwrap_or_else(PoisonError::into_inner).take();
        if let Some(responder) = responder {
            // No names would mean all parameters.
            let values = if self.names.is_empty() { Vec::new() } else { self.parameters.of(&self.names) };
            responder.respond(values);
        }
    }
}

/// The guard's limits as parameters below `prefix`; limits that are not set are left out.
pub(super) fn of_guard(prefix: &str, guard: &GuardSettings) -> Vec<Parameter> {
    let number = |name: &str, value: f64| Parameter::float64(format!("{prefix}guard.{name}"), value);
    let flag = |name: &str, value: bool| Parameter::bool(format!("{prefix}guard.{name}"), value);
    let optional =
        [("force_n", guard.force_n), ("pressure_kpa", guard.pressure_kpa), ("stale_after_ms", guard.stale_after_ms)];
    let mut all: Vec<_> = optional.into_iter().filter_map(|(name, value)| Some(number(name, value?))).collect();
    all.extend([
        flag("any_touch", guard.stops_at_any_touch()),
        flag("damage", guard.damage),
        number("hold_ms", guard.hold_ms),
        number("most_left_out_percent", guard.most_left_out_percent),
    ]);
    all
}
