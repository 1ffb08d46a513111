"""A body of sixteen skins: its load on an idle computer, and three failing skins that must not affect the others."""

import contextlib
import gc
import math
import os
import random
import sys
import threading
import time
from pathlib import Path

from .tools import Page, attack, check, serve

SKINS = 16
RATE = 100
# Places of two presses that circle the skin, and frames per place.
PLACES, REPEATS = 100, 10
# Time for which a failing instrument sends frames before its fault, seconds.
SOUND_S = 1
# Limits for sixteen skins: share of two processors, latency (99th percentile) and memory.
MOST_LOAD, MOST_P99_MS, MOST_MB = 0.6, 5.0, 600


def press_table():
    rows = ["x_mm,y_mm,force_n,group"]
    for k in range(PLACES):
        for radius, ahead in ((25, 0.0), (20, 2.5)):
            angle = 2 * math.pi * k / PLACES + ahead
            rows.append(f"{radius * math.cos(angle):.2f},{radius * math.sin(angle):.2f},3.0,{k}")
    return "\n".join(rows) + "\n"


def pressed_lines(ground):
    """A skin file of 208 channels, frames of the untouched skin, and lines of frames of two presses."""
    made = ground.ask("new", "pad", "--outline", "disc:100", "--electrodes", 16, "--layer", "gel")
    check(made.code == 0, made.err()[-300:])
    path = ground.folder / "pad.toml"
    path.write_text(path.read_text().replace("frames_per_s = 25.0", f"frames_per_s = {RATE}.0"))
    ground.skin("presses.csv", press_table())
    table = ["--presses", "presses.csv", "--baseline", "rest.csv", "--frames", "frames.csv"]
    sampled = ground.ask("twin", "sample", path, *table, "--repeats", REPEATS)
    check(sampled.code == 0, sampled.err()[-300:])
    rows = (ground.folder / "frames.csv").read_text().splitlines()
    rows = [row for row in rows if row[:1] in "-0123456789"]
    return [(row.replace(",", " ") + "\n").encode() for row in rows]


class Beat:
    """Sends frames from the working instruments to their hosts at the skins' rate, in one thread."""

    def __init__(self, ground, lines):
        self.lines, self.guests, self.ended = lines, [], threading.Event()
        self.random = ground.random
        threading.Thread(target=self._send, daemon=True).start()

    def talk(self, connection, _, ended):
        """Serves a host until it disconnects."""
        guest = [connection, self.random.randrange(len(self.lines))]
        self.guests.append(guest)
        while not ended.is_set() and guest in self.guests:
            time.sleep(0.1)

    def _send(self):
        begun, k = time.monotonic(), 0
        while not self.ended.is_set():
            time.sleep(max(0.0, begun + k / RATE - time.monotonic()))
            for guest in list(self.guests):
                connection, first = guest
                try:
                    connection.sendall(self.lines[(first + k) % len(self.lines)])
                except OSError:
                    self.guests.remove(guest)
            k += 1


def failing(lines, then):
    """An instrument that sends frames for a while and then fails."""

    def talk(connection, _, ended):
        begun = time.monotonic()
        for k in range(SOUND_S * RATE):
            time.sleep(max(0.0, begun + k / RATE - time.monotonic()))
            connection.sendall(lines[k % len(lines)])
        while not ended.is_set() and then(connection):
            time.sleep(0.01)

    return talk


def silence(_):
    return True


def unplugged(_):
    return False


def garbage(connection):
    connection.sendall(random.Random(1).randbytes(1 << 12))
    return True


class BodyPage(Page):
    """The page of a body: keeps its last state."""

    def _text(self, message):
        del self.states[:-1]
        super()._text({**message, "type": "state"} if message["type"] == "body_state" else message)

    def patches(self):
        return self.states[-1][1]["patches"]


def processor_s(pid):
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


@contextlib.contextmanager
def sent_on_time():
    """Keeps this process from delaying its senders: one that is late sends several frames at once."""
    interval = sys.getswitchinterval()
    gc.disable()
    sys.setswitchinterval(0.0002)
    try:
        yield
    finally:
        sys.setswitchinterval(interval)
        gc.enable()


@sent_on_time()
def run_body(ground, lines, seconds, faulty):
    """Runs sixteen skins, the last ones with these faulty senders; returns figures of the others."""
    ends, ports, body = [], [], 'name = "many"\n'
    beat = Beat(ground, lines)
    senders = [beat.talk] * (SKINS - len(faulty)) + [failing(lines, then) for then in faulty]
    for k, talk in enumerate(senders):
        port, _, end = serve(talk)
        ends.append(end)
        ports.append(port)
        body += f'\n[[patch]]\nname = "p{k}"\nskin = "pad.toml"\nsource = "tcp:127.0.0.1:{port}#lines"\n'
        body += f'baseline = "rest.csv"\nlink = "body"\nxyz_mm = [{150 * k}, 0, 0]\n'
    ground.skin("many.toml", body)
    command = ground.start("run", "many.toml", "--no-open", "--port", 0, "--record", ground.folder / f"{ports[0]}.mcap")
    page = BodyPage(command.url())
    sound = SKINS - len(faulty)
    touched = lambda: page.states and all(len(patch["touches"]) == 2 for patch in page.patches()[:sound])  # noqa: E731
    page.wait_for(touched, 60, "two touches on each skin")
    before, used, begun = page.patches(), processor_s(command.pid), time.monotonic()
    time.sleep(seconds)
    after, took = page.patches(), time.monotonic() - begun
    figures = {
        "load": (processor_s(command.pid) - used) / took / 2,
        "p99_ms": max(patch["latency_p99_ms"] for patch in after[:sound]),
        "lost": sum(patch["lost"] for patch in after[:sound]),
        "rate": min(b["frames"] - a["frames"] for a, b in zip(before[:sound], after[:sound])) / took,
        "states": [patch["state"] for patch in after[sound:]],
    }
    command.signal(2)
    command.wait(20)
    figures["memory_mb"] = command.peak_mb()
    for end in [*ends, beat.ended.set]:
        end()
    page.close()
    return figures


def said(ground, what, figures):
    ground.say(
        f"{what}: at least {figures['rate']:.1f} frames/s on each sound skin, {figures['lost']} lost, p99 port to touch"
        f" {figures['p99_ms']:.2f} ms on the slowest, {100 * figures['load']:.0f} % of two processors,"
        f" {figures['memory_mb']:.0f} MB"
    )


@attack("body-load", "16 skins of 208 channels at 100 frames/s with two touches each, recorded, one page")
def body_load(ground):
    figures = run_body(ground, pressed_lines(ground), ground.options.seconds or 30, [])
    said(ground, "16 skins", figures)
    check(figures["lost"] == 0 and figures["rate"] > 0.98 * RATE, "frames are missing")
    check(figures["load"] <= MOST_LOAD, "too much load")
    check(figures["p99_ms"] <= MOST_P99_MS, "too late")
    check(figures["memory_mb"] <= MOST_MB, "too much memory")


@attack("body-faults", "three of 16 skins silent, unplugged every second, and sending garbage, with --seconds each")
def body_faults(ground):
    lines, seconds = pressed_lines(ground), ground.options.seconds or 30
    quiet = run_body(ground, lines, seconds, [silence] * 3)
    said(ground, "three silent", quiet)
    figures = run_body(ground, lines, seconds, [silence, unplugged, garbage])
    said(ground, f"faults ({', '.join(figures['states'])})", figures)
    check(figures["lost"] == 0 and figures["rate"] > 0.98 * RATE, "the sound skins lose frames")
    check(figures["p99_ms"] <= max(1.2 * quiet["p99_ms"], MOST_P99_MS), "the sound skins are late")
