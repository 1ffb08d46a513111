"""A twin behind the wire, recorded, with three pages, one of which never reads, under two faults of all kinds per
second, and a kill -9 every minute."""

import json
import signal
import statistics
import subprocess
import time

from .files import info, numbers_of
from .tools import Ground, Page, attack, check, connect
from .wire import HELLO, START

MINUTE_S = 60.0
# Longest part that a killed recording may lack, seconds.
PROMISED_S = 1.0


class Session:
    """One life of `dermis run`, from its start to its kill or its end."""

    def __init__(self, ground, twin, number):
        self.ground = ground
        self.target = ground.folder / f"session-{number}.mcap"
        source = f"tcp:127.0.0.1:{twin}"
        self.run = ground.start(
            "run", ground.options.skin, "--source", source, "--no-open", "--port", 0, "--record", self.target
        )
        self.address = self.run.url()
        self.pages = [Page(self.address), Page(self.address)]
        # The third page never reads.
        self.stuck = Page(self.address, acknowledges=False, reads=False, receive_buffer=4096)
        self.memory = []

    def sample(self):
        self.memory.append(self.run.memory_mb())

    def p99_ms(self):
        """99th percentile of the time from a frame's first byte to its results, over the session until now."""
        states = self.pages[0].states
        return next(s["p99_us"] for s in states[-1][1]["latency"] if s["stage"] == "total") * 1e-3

    def stages_p99_ms(self):
        """The same for each stage; the remaining time goes into damage, health and baselines."""
        stages = self.pages[0].states[-1][1]["latency"]
        return ", ".join(f"{s['stage']} {s['p99_us'] * 1e-3:.1f}" for s in stages if s["stage"] != "total")

    def mean_fps(self):
        states = self.pages[0].states
        return (states[-1][1]["frame"] - states[0][1]["frame"]) / max(states[-1][0] - states[0][0], 1e-9)

    def close(self):
        for page in [*self.pages, self.stuck]:
            page.close()

    def killed(self):
        """Kills the run, recovers its recording and compares it with the frames shown on the page."""
        states = list(self.pages[0].states)
        at = time.time()
        self.run.kill()
        partial = self.target.with_name(self.target.stem + ".partial.mcap")
        again = self.ground.folder / "recovered.mcap"
        again.unlink(missing_ok=True)
        asked = self.ground.ask("recover", partial, "--out", again)
        check(asked.code == 0, f"recover ended with {asked.code}: {asked.err()[-300:]}")
        there = numbers_of(self.ground, again)
        self.counted(there, states)
        last = states[-1][1]
        # Frames that the page had shown a second before the kill.
        old = [s["frame"] for _, s in states if int(s["time_ns"]) * 1e-9 < int(last["time_ns"]) * 1e-9 - PROMISED_S]
        kept = set(there)
        lacking = [n for n in old if n not in kept]
        check(not lacking, f"frames {lacking[:5]} were shown a second before the kill and are not in the recording")
        for path in (partial, again):
            path.unlink()
        return len(there), at

    def counted(self, there, states):
        """Checks that the counters account for every number missing from a recording."""
        check(len(set(there)) == len(there), "a frame was recorded twice")
        missing = set(range(there[0], there[-1] + 1)) - set(there)
        losses = {c["name"]: c["value"] for c in states[-1][1]["counters"] if c["is_loss"]}
        known = [n for n in missing if n <= states[-1][1]["frame"]]
        check(len(known) <= sum(losses.values()), f"{len(known)} frames are missing and only {losses} were counted")
        self.missing, self.losses = len(known), losses


class Faults:
    """Faults, one at a time."""

    def __init__(self, ground, twin, port):
        self.ground, self.twin, self.port, self.rng = ground, twin, port, ground.random
        self.open = []
        self.counts = {}

    def happen(self, session):
        what = self.rng.choice(
            [
                self.touch,
                self.cut,
                self.heal,
                self.fault,
                self.repair,
                self.renew,
                self.line,
                self.page_command,
                self.page_noise,
                self.half_open,
                self.page_flood,
                self.silent_host,
                self.hostile_host,
                self.stall,
                self.new_page,
            ]
        )
        self.counts[what.__name__] = self.counts.get(what.__name__, 0) + 1
        try:
            what(session)
        except OSError:
            pass
        while len(self.open) > 60:
            self.open.pop(0).close()

    def type(self, text):
        self.twin.type(text + "\n")

    def at(self):
        return f"{self.rng.uniform(-45, 45):.1f} {self.rng.uniform(-45, 45):.1f}"

    def touch(self, _):
        self.type(self.rng.choice([f"press {self.at()} 20", "release", "press nan 0 1", "press 0 0 1e9"]))

    def cut(self, _):
        self.type(self.rng.choice([f"cut {self.at()} {self.at()}", "cut 0 0 20 0", "cut -50000 0 50000 0"]))

    def heal(self, _):
        self.type(f"heal {self.at()} 15 90 2")

    def fault(self, _):
        n = self.rng.randrange(1, 17)
        self.type(
            self.rng.choice(
                [
                    f"fault electrode {n} open",
                    f"fault electrodes {n} {n % 16 + 1} shorted",
                    f"fault channel {n} stuck 1",
                    f"fault channel {n} noisy 5",
                    "fault frames lost 0.2",
                    "fault frames repeated 0.2",
                    "fault electrode 99 open",
                ]
            )
        )

    def repair(self, _):
        self.type("repair")

    def renew(self, _):
        self.type("renew")

    def line(self, _):
        self.twin.type(self.rng.randbytes(self.rng.randrange(1, 3000)) + b"\n")

    def page_command(self, session):
        page = self.rng.choice(session.pages)
        page.ask(
            self.rng.choice(
                [
                    {"tare": {"force": True}},
                    {"tare": {"force": False}},
                    {"hyperparameter": 10 ** self.rng.uniform(-3, 1)},
                    {"hyperparameter": -1},
                    {"treat": "renew"},
                    {"choose_channels": [0, 5]},
                    "record_start",
                ]
            )
        )

    def page_noise(self, session):
        page = Page(session.address)
        for _ in range(50):
            page.frame(self.rng.randbytes(self.rng.randrange(1, 300)))
        self.open.append(page)

    def page_flood(self, session):
        page = Page(session.address)
        for k in range(3000):
            page.frame(b'{"v": 1, "id": %d, "command": {"hyperparameter": 0.5}}' % k)
        page.close()

    def new_page(self, session):
        page = Page(session.address)
        time.sleep(0.1)
        page.close()

    def half_open(self, session):
        for _ in range(20):
            connection = connect(session.address[1], 2)
            connection.sendall(b"GET / HTTP/1.1\r\nHo")
            self.open.append(connection)

    def silent_host(self, _):
        self.open.append(connect(self.port, 2))

    def hostile_host(self, _):
        connection = connect(self.port, 2)
        connection.sendall(self.rng.choice([self.rng.randbytes(20000), HELLO + START, HELLO * 500, b"\0" * 20000]))
        self.open.append(connection)

    def stall(self, _):
        """The instrument sends nothing for a while, then everything at once."""
        self.twin.signal(signal.SIGSTOP)
        time.sleep(self.rng.uniform(0.01, 0.3))
        self.twin.signal(signal.SIGCONT)

    def end(self):
        for one in self.open:
            one.close()


class Presses:
    """Ordinary use, as a reference for chaos: a one-second press at a random place every two seconds."""

    def __init__(self, ground, twin):
        self.twin, self.rng, self.asked = twin, ground.random, 0

    def happen(self, _):
        self.asked += 1
        if self.asked % 4 == 1:
            self.twin.type(f"press {self.rng.uniform(-45, 45):.1f} {self.rng.uniform(-45, 45):.1f} 20 10\n")
        elif self.asked % 4 == 3:
            self.twin.type("release\n")


def tared(session):
    session.pages[0].runs(5, 60)


@attack(
    "chaos", "a twin, recorded, three pages of which one is stuck, 2 faults a second, kill -9 every minute; --seconds"
)
def chaos(ground: Ground):
    seconds = ground.options.seconds or 600.0
    twin = ground.start("twin", "serve", ground.options.skin, "--tcp", "127.0.0.1:0", stdin=True)
    port = twin.port()
    quiet = Session(ground, port, 0)
    tared(quiet)
    watch(quiet, twin, min(MINUTE_S, max(20.0, 0.1 * seconds)), Presses(ground, twin), [])
    quiet_p99, quiet_fps = quiet.p99_ms(), quiet.mean_fps()
    quiet.killed()
    quiet.close()
    ground.say(f"quiet: {quiet_fps:.1f} frames/s, 99th percentile {quiet_p99:.1f} ms")
    faults = Faults(ground, twin, port)
    twin_memory, p99s, peaks = [], [], []
    end, number, recorded, missing, counted = time.monotonic() + seconds, 0, 0, 0, 0
    frames = 0
    while time.monotonic() < end:
        number += 1
        faults.type("repair")
        faults.type("renew")
        faults.type("release")
        session = Session(ground, port, number)
        tared(session)
        watch(session, twin, min(MINUTE_S, max(10.0, end - time.monotonic())), faults, twin_memory)
        check(twin.poll() is None, f"the twin ended with {twin.code}: {twin.err()[-500:]}")
        frames += session.pages[0].states[-1][1]["frame"]
        p99s.append(session.p99_ms())
        peaks.append(max(session.memory))
        stages = session.stages_p99_ms()
        kept, _ = session.killed()
        recorded, missing, counted = recorded + kept, missing + session.missing, counted + sum(session.losses.values())
        session.close()
        ground.say(
            f"session {number}: {kept} frames recovered, {session.missing} missing, counted {session.losses}, "
            f"p99 {p99s[-1]:.1f} ms ({stages}), {peaks[-1]:.0f} MB; twin {twin.memory_mb():.0f} MB"
        )
    # The last session ends as a user would end it.
    last = Session(ground, port, number + 1)
    tared(last)
    last.run.signal(signal.SIGINT)
    last.run.wait(20)
    states = list(last.pages[0].states)
    check(last.run.code in (0, 3), f"the last run ended with {last.run.code}: {last.run.err()[-300:]}")
    check(info(ground, last.target)["whole"], "the last recording is incomplete")
    last.counted(numbers_of(ground, last.target), states)
    last.close()
    faults.end()
    twin.signal(signal.SIGINT)
    twin.wait(20)
    left = subprocess.run(["ps", "-eo", "pid,args"], capture_output=True, text=True).stdout
    left = [line for line in left.splitlines() if str(ground.folder) in line or f"127.0.0.1:{port}" in line]
    half = len(twin_memory) // 2
    early, late = statistics.median(twin_memory[10:half]), statistics.median(twin_memory[half:])
    ground.say(f"faults: {sum(faults.counts.values())} of {len(faults.counts)} kinds: {json.dumps(faults.counts)}")
    ground.say(
        f"{number} kills; {recorded} frames recovered, {missing} missing between, {counted} counted as lost;"
        f" 99th percentile {statistics.median(p99s):.1f} ms in the median of sessions,"
        f" {max(p99s):.1f} ms in the worst, quiet {quiet_p99:.1f} ms;"
        f" memory of the run at most {min(peaks):.0f} to {max(peaks):.0f} MB a session, of the twin"
        f" {early:.0f} MB in the first half and {late:.0f} MB in the second; {len(left)} processes left"
    )
    check(not left, f"left: {left}")
    check(late < 1.2 * early + 20, f"the twin's memory grew from {early:.0f} to {late:.0f} MB")
    check(peaks[-1] < 1.3 * statistics.median(peaks) + 50, f"the run's memory grew: {[round(p) for p in peaks]}")
    check(missing <= counted, f"{missing} frames are missing, {counted} counted")
    check(
        max(p99s) <= 2 * quiet_p99,
        f"the 99th percentile of the worst session is {max(p99s):.1f} ms, quiet {quiet_p99:.1f} ms",
    )


def watch(session, twin, seconds, faults, twin_memory):
    """Lets a session run, with a fault twice a second."""
    end, next_fault, next_sample = time.monotonic() + seconds, time.monotonic(), time.monotonic()
    while time.monotonic() < end:
        now = time.monotonic()
        if now >= next_sample:
            session.sample()
            twin_memory.append(twin.memory_mb())
            next_sample += 1.0
        if now >= next_fault:
            faults.happen(session)
            next_fault += 0.5
        check(session.run.poll() is None, f"the run ended with {session.run.code}: {session.run.err()[-600:]}")
        check(not session.pages[0].ended, f"a good page was closed with {session.pages[0].close_code}")
        time.sleep(0.02)
