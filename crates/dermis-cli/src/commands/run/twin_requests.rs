//! Carries out the requests of a page that are for the twin: presses, cuts, healing, its demonstration.

use dermis::source::TwinControl;
use dermis_lab::twin_commands::{CommandRefused, TwinCommand};
use dermis_page::feed::PageFeed;
use dermis_twin::from_skin::treatment_of;

use crate::page::{Command, Reply, Request};

/// Carries out the request if it is for the twin; otherwise hands back its command and reply.
pub(super) fn carry_out(request: Request, twin: Option<&TwinControl>, feed: &mut PageFeed) -> Option<(Command, Reply)> {
    let reply = request.reply;
    match request.command {
        Command::Press(press) | Command::Move(press) => {
            let press = TwinCommand::Press {
                pointer: press.pointer_id,
                position_m: press.position_m(),
                radius_m: press.radius_m(),
                pressure_pa: press.pressure_pa(),
            };
            ask(twin, press, reply);
        }
        Command::Release { pointer_id } => ask(twin, TwinCommand::Release { pointer: pointer_id }, reply),
        Command::Treat(action) => {
            feed.demonstrate(false);
            ask(twin, TwinCommand::Treat(treatment_of(action)), reply);
        }
        Command::Demonstrate(wanted) => match command(twin, TwinCommand::Demonstrate(wanted)) {
            Ok(()) => {
                feed.demonstrate(wanted);
                let [on, off] = ["the twin shows touches by itself", "only you press the twin"];
                reply.accept(if wanted { on } else { off });
            }
            Err(refused) => reply.refuse(format!("refused: {refused}")),
        },
        other => return Some((other, reply)),
    }
    None
}

fn command(twin: Option<&TwinControl>, command: TwinCommand) -> Result<(), CommandRefused> {
    twin.map_or(Ok(()), |twin| twin.commands.send(command))
}

/// Hands a command to the twin; replies only if it is refused.
fn ask(twin: Option<&TwinControl>, asked: TwinCommand, reply: Reply) {
    if let Err(refused) = command(twin, asked) {
        reply.refuse(format!("refused: {refused}"));
    }
}
