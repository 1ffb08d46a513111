"""Bursts of requests to a twin: through the page, and on standard input of a served one."""

import random
import signal
import time

from .tools import Page, attack, check, connect
from .wire import Host

CUT = {"cut": {"from_mm": [0, 0], "to_mm": [20, 0]}}
# Longest time without a frame at 25 frames per second, on a machine with other work to do, seconds.
LONGEST_GAP_S = 1.0


def cut(k, length_mm=20.0):
    return {"cut": {"from_mm": [-length_mm / 2, -30 + k], "to_mm": [length_mm / 2, -30 + k]}}


def heal(k):
    return {"heal": {"at_mm": [k % 40 - 20, k // 40], "radius_mm": 15, "temperature_c": 90, "hours": 2}}


BURSTS = {
    "3 equal cuts": ([{"treat": CUT}] * 3, ["cut 0 0 20 0"] * 3),
    "60 cuts": ([{"treat": cut(k)} for k in range(60)], [f"cut -10 {-30 + k} 10 {-30 + k}" for k in range(60)]),
    "cuts of 100 m": (
        [{"treat": cut(k, 1e5)} for k in range(8)],
        [f"cut -50000 {-30 + k} 50000 {-30 + k}" for k in range(8)],
    ),
    "300 heals": (
        [{"treat": heal(k)} for k in range(300)],
        [f"heal {k % 40 - 20} {k // 40} 15 90 2" for k in range(300)],
    ),
}


@attack("page-bursts", "cuts, heals and hyperparameters in bursts through the page; 3 SIGINT meanwhile")
def page_bursts(ground):
    command = ground.start("run", "healing-square", "--no-open", "--port", 0)
    page = Page(command.url())
    page.runs()
    page.ask({"demonstrate": False})
    # Measure the machine's effect on an idle twin.
    begun = time.monotonic()
    time.sleep(5)
    quiet = page.gap(begun)
    for what, (commands, _) in BURSTS.items():
        burst(ground, command, page, what, commands, quiet)
        page.ask({"treat": "renew"})
        time.sleep(2)
    hyperparameters = [{"hyperparameter": 0.001 * 1.01**k} for k in range(300)]
    burst(ground, command, page, "300 hyperparameters", hyperparameters, quiet)
    value = page.states[-1][1]["state"]["hyperparameter"]
    check(abs(value - 0.001 * 1.01**299) < 1e-9, f"the last hyperparameter is not in use, but {value}")
    for commands, _ in BURSTS.values():
        for command_ in commands:
            page.ask(command_)
    three_signals(ground, command)


def random_cut(dice):
    """A cut at a random place on the skin, so that most cuts cross each other and pads."""
    return {"treat": {"cut": {end: [dice.uniform(-60, 60), dice.uniform(-60, 60)] for end in ("from_mm", "to_mm")}}}


def random_heal(dice):
    at, radius = [dice.uniform(-60, 60), dice.uniform(-60, 60)], dice.uniform(2, 60)
    heat = {"temperature_c": dice.uniform(40, 150), "hours": dice.uniform(0.1, 24)}
    return {"treat": {"heal": {"at_mm": at, "radius_mm": radius, **heat}}}


# Longest additional time without a state compared with an idle twin, seconds: two and a half frames at 25 frames/s.
LONGEST_TREATED_S = 0.1


@attack("page-treatments", "random cuts and heals through the page, in bursts and as a stream; 3 SIGINT meanwhile")
def page_treatments(ground):
    command = ground.start("run", "healing-square", "--no-open", "--port", 0)
    page = Page(command.url())
    page.runs()
    page.ask({"demonstrate": False})
    begun = time.monotonic()
    time.sleep(5)
    quiet = page.gap(begun)
    dice = random.Random(39)
    cuts = [random_cut(dice) for _ in range(60)]
    heals = [random_heal(dice) for _ in range(60)]
    mixed = [ask for pair in zip(cuts, heals) for ask in pair]
    for what, commands, pause_s in [
        ("32 random cuts", cuts[:32], 0.0),
        ("60 random cuts and 60 heals", cuts + heals, 0.0),
        ("a stream of cuts and heals", mixed, 8.0 / 120),
        ("cuts, heals and new sheets", [one for ask in mixed[:40] for one in (ask, {"treat": "renew"})], 0.1),
    ]:
        answers, begun = len(page.answers), time.monotonic()
        for one in commands:
            page.ask(one)
            time.sleep(pause_s)
        time.sleep(max(2.0, begun + 10.0 - time.monotonic()))
        gap, losses = page.gap(begun), page.losses()
        seconds = time.monotonic() - begun
        states = sum(at > begun for at, _ in page.states)
        refused = sum(not answer["ok"] for answer in page.answers[answers:])
        ground.say(f"{what}: longest time without a state {gap:.2f} s (quiet {quiet:.2f} s), {states / seconds:.1f} states/s,"
                   f" {refused} of {len(commands)} refused, losses {losses}")
        check(command.poll() is None, f"the command ended with {command.code}: {command.err()[-600:]}")
        check(gap < LONGEST_TREATED_S + quiet, f"{what}: no state for {gap:.2f} s")
        check(not any(losses.values()), f"{what}: frames were lost: {losses}")
        page.ask({"treat": "renew"})
        time.sleep(2)
    for one in mixed:
        page.ask(one)
    three_signals(ground, command)


def burst(ground, command, page, what, commands, quiet):
    answers = len(page.answers)
    begun = time.monotonic()
    for one in commands:
        page.ask(one)
    time.sleep(8)
    gap, losses = page.gap(begun), page.losses()
    refused = sum(not answer["ok"] for answer in page.answers[answers:])
    ground.say(
        f"{what}: longest time without a frame {gap:.2f} s (quiet {quiet:.2f} s), {refused} refused, losses {losses}"
    )
    check(command.poll() is None, f"the command ended with {command.code}: {command.err()[-600:]}")
    check(gap < LONGEST_GAP_S + quiet, f"{what}: no frame for {gap:.2f} s")
    check(not any(losses.values()), f"{what}: frames were lost: {losses}")


def three_signals(ground, command):
    for _ in range(3):
        command.signal(signal.SIGINT)
        asked = time.monotonic()
        time.sleep(0.1)
    command.wait(5)
    took = time.monotonic() - asked
    ground.say(f"3 SIGINT 0.1 s apart: ended with {command.code}, {took:.2f} s after the last")
    check(command.code in (0, 130), f"ended with {command.code}: {command.err()[-600:]}")
    check(took < 1.0, f"the command kept running for {took:.2f} s after the last signal")


@attack("stdin-bursts", "the same on standard input of a served twin, read by a host")
def stdin_bursts(ground):
    served = ground.start("twin", "serve", "healing-square", "--no-demo", "--tcp", "127.0.0.1:0", stdin=True)
    host = Host(connect(served.port()))
    host.start()
    host.wait_for_frames(25)
    begun = time.monotonic()
    time.sleep(5)
    quiet = host.gap(begun)
    for what, (_, lines) in BURSTS.items():
        begun = time.monotonic()
        served.type("".join(line + "\n" for line in lines))
        time.sleep(8)
        gap = host.gap(begun)
        refused = served.err().count("refused:")
        ground.say(f"{what}: longest time without a frame {gap:.2f} s (quiet {quiet:.2f} s), {refused} refused by now")
        check(served.poll() is None, f"the twin ended with {served.code}: {served.err()[-600:]}")
        check(gap < LONGEST_GAP_S + quiet, f"{what}: no frame for {gap:.2f} s")
        check(host.missing == 0, f"{what}: {host.missing} frames are missing")
        served.type("renew\n")
        time.sleep(2)
    served.type("x" * 3_000_000 + "\n" + "\x1b[31mcut\n" + "press nan nan 1\n" + "\0" * 1000 + "\n")
    time.sleep(1)
    check(served.poll() is None, f"hostile lines ended the twin with {served.code}: {served.err()[-600:]}")
    for _, lines in BURSTS.values():
        served.type("".join(line + "\n" for line in lines))
    three_signals(ground, served)
