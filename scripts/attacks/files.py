"""File names taken in the meantime, killed processes, full disks, and names with terminal control characters."""

import json
import os
import re
import resource
import signal
import subprocess
import time

from .tools import Page, attack, check

# Longest part that a killed recording may lack, seconds.
PROMISED_S = 1.0
OURS = b"somebody else's\n"


def info(ground, path):
    asked = ground.ask("info", path, "--json")
    check(asked.code == 0, f"info {path}: ended with {asked.code}: {asked.err()[-300:]}")
    return json.loads(asked.out())


def numbers_of(ground, path):
    """Frame numbers of a recording, from its exported table."""
    table = ground.folder / "frames.csv"
    table.unlink(missing_ok=True)
    asked = ground.ask("export", path, "--out", table)
    check(asked.code in (0, 3), f"export {path}: ended with {asked.code}: {asked.err()[-300:]}")
    with table.open() as lines:
        next(lines)
        return [int(line.split(",", 1)[0]) for line in lines]


@attack("final-names", "a file appears under the final name of a recording, export, calibration, model, sample")
def final_names(ground):
    target = ground.folder / "press.mcap"
    recorded = ground.start("record", "healing-square", "--seconds", 3, "--out", target)
    recorded_partial = ground.folder / "press.partial.mcap"
    wait_for(recorded_partial.exists, recorded)
    time.sleep(1.5)
    target.write_bytes(OURS)
    recorded.wait(60)
    check(target.read_bytes() == OURS, "the file under the final name was replaced")
    check(recorded.code == 3, f"record ended with {recorded.code}: {recorded.err()[-300:]}")
    check("press.partial.mcap" in recorded.err(), f"the partial recording is not named: {recorded.err()[-300:]}")
    found = info(ground, recorded_partial)
    check(found["whole"], "the partial recording is incomplete")
    ground.say(f"recording: the file stays, status 3, {found['frames']} frames in the partial recording, which is named")
    make = {
        "export": (["export", "press.partial.mcap", "--out", "table.csv"], "table.csv"),
        "recover": (["recover", "press.partial.mcap", "--out", "again.mcap"], "again.mcap"),
        "forces": (["calibrate", "ionic-disc", "--twin", "--forces", "forces.json"], "forces.json"),
        "calibration": (["calibrate", "ionic-disc", "--twin", "--pokes", "12", "--out", "c.json"], "c.json"),
        "sample": (
            ["twin", "sample", "ionic-disc", "--presses", "random:400", "--baseline", "b.npy", "--frames", "f.npy"],
            "f.npy",
        ),
    }
    ground.ask("train-set", "ionic-disc", "--samples", 200, "--shard", 20, "--out", "set")
    train = "train --set set --out model.json --width 4 --levels 3 --epochs 3 --batch 10 --held-out 0.5"
    make["model"] = (train.split(), "model.json")
    for what, (question, name) in make.items():
        appears(ground, what, question, ground.folder / name)


def appears(ground, what, question, target):
    """A file appears under the final name while the command works: at its start, and once it has started writing."""
    for moment in ("at work", "writing"):
        target.unlink(missing_ok=True)
        before = set(os.listdir(ground.folder))
        command = ground.start(*question)
        before |= {os.path.basename(file.name) for file in (command.out_file, command.err_file)}
        if moment == "at work":
            time.sleep(0.3)
            caught = command.poll() is None and not target.exists()
            if caught:
                target.write_bytes(OURS)
        else:
            caught = stopped_while_writing(ground, command, target, before)
        command.wait(120)
        if not caught:
            ground.say(f"{what}, {moment}: too quick to be caught")
            continue
        check(target.read_bytes() == OURS, f"{what}, {moment}: the file under the final name was replaced")
        check(command.code in (1, 2, 3), f"{what}, {moment}: ended with {command.code}")
        check("not replaced" in command.err(), f"{what}, {moment}: not said: {command.err()[-300:]}")
        ground.say(f"{what}, {moment}: the file stays, status {command.code}, the finished one is kept and named")
        target.unlink()


def stopped_while_writing(ground, command, target, before):
    """Stops the command as soon as it has opened a file for writing, and puts a file under its final name."""
    while command.poll() is None:
        if set(os.listdir(ground.folder)) - before and not target.exists():
            command.signal(signal.SIGSTOP)
            caught = not target.exists()
            if caught:
                target.write_bytes(OURS)
            command.signal(signal.SIGCONT)
            return caught
    return False


def wait_for(condition, process, timeout=60):
    end = time.monotonic() + timeout
    while not condition():
        check(process.poll() is None, f"{process.name}: ended with {process.code}: {process.err()[-300:]}")
        check(time.monotonic() < end, f"{process.name}: not within {timeout} s")
        time.sleep(0.005)


@attack("early-signals", "SIGINT at 50 random moments of the first half second, and of 10 after, of a recording")
def early_signals(ground):
    codes = {}
    for k in range(60):
        target = ground.folder / f"early-{k}.mcap"
        command = ground.start("record", "ionic-disc", "--out", target)
        time.sleep(ground.random.uniform(0, 0.5) if k < 50 else ground.random.uniform(0.5, 4))
        command.signal(signal.SIGINT)
        asked = time.monotonic()
        command.wait(20)
        took = time.monotonic() - asked
        codes[command.code] = codes.get(command.code, 0) + 1
        # The signal handler either was not installed yet, or worked.
        check(command.code in (0, 130, -signal.SIGINT), f"ended with {command.code}: {command.err()[-300:]}")
        check(took < 10, f"went on for {took:.1f} s")
        partial = target.with_name(f"early-{k}.partial.mcap")
        check(not partial.exists(), f"signal {k}: left a partial behind: {command.err()[-300:]}")
        if target.exists():
            found = info(ground, target)
            check(found["whole"], f"signal {k}: the recording is incomplete")
            codes["whole recordings"] = codes.get("whole recordings", 0) + 1
            target.unlink()
    ground.say(f"60 signals: {codes}")


@attack("kill", "kill -9 at 200 random moments of a recording, and recover")
def kill(ground):
    rounds = int(os.environ.get("ATTACK_ROUNDS", "200"))
    most_lost, begun, frames_in_all, bounds = 0.0, 0, 0, []
    for k in range(rounds):
        target = ground.folder / "killed.mcap"
        partial = ground.folder / "killed.partial.mcap"
        again = ground.folder / "again.mcap"
        command = ground.start("run", "ionic-disc", "--headless", "--record", target)
        command.until(r'"sequence": ?0\b', 60)
        time.sleep(ground.random.uniform(0, 3.0))
        killed = time.time()
        command.kill()
        lines = [json.loads(line) for line in command.out().splitlines(True) if line.endswith("\n")]
        # Age of each frame when the process was killed: the last one had just been printed, the others earlier.
        since_last = max(0.0, killed - os.stat(command.out_file.name).st_mtime)
        ages = {line["sequence"]: since_last + lines[-1]["time_s"] - line["time_s"] for line in lines}
        check(not target.exists() and partial.exists(), f"kill {k}: {os.listdir(ground.folder)}")
        recovered = ground.ask("recover", partial, "--out", again)
        if recovered.code == 2 and "no frames" in recovered.err():
            check(max(ages.values()) < PROMISED_S, f"kill {k}: nothing is left of {max(ages.values()):.2f} s")
            partial.unlink()
            continue
        check(recovered.code == 0, f"kill {k}: recover ended with {recovered.code}: {recovered.err()[-300:]}")
        said = ground.ask("info", partial)
        bound = re.search(r"at most its last second, (\d+) frames", said.out())
        there = numbers_of(ground, again)
        check(len(there) == len(set(there)), f"kill {k}: a frame is there twice")
        check(there == sorted(there), f"kill {k}: out of order")
        missing = [n for n in ages if n not in set(there)]
        age = max((ages[n] for n in missing), default=0.0)
        most_lost = max(most_lost, age)
        check(age < PROMISED_S, f"kill {k}: frame {missing[:1]} was {age:.2f} s old and is not there")
        # A busy computer leaves out frames of the twin, which are not printed either.
        gaps = [n for n in missing if n < max(there, default=0)]
        check(not gaps, f"kill {k}: frames {gaps[:5]} are missing in the middle")
        if bound:
            bounds.append((len(missing), int(bound[1])))
            check(
                len(missing) <= int(bound[1]),
                f"kill {k}: at most {bound[1]} were said to be missing, {len(missing)} are",
            )
        begun += 1
        frames_in_all += len(there)
        for path in (partial, again):
            path.unlink()
        forget(ground, command, recovered, said)
    worst = max((missing for missing, _ in bounds), default=0)
    ground.say(
        f"{rounds} kills: {frames_in_all} frames recovered, none twice, none missing between;"
        f" the oldest frame that was lost was {most_lost:.2f} s old; at most {worst} frames missing,"
        f" within the bound that was printed every time"
        f" ({len(bounds)} times)"
    )
    check(begun > rounds / 2, f"only {begun} recordings had begun")


def forget(ground, *processes):
    """Removes their logs and names, since there are many."""
    for process in processes:
        process.check_sound()
        ground.processes.remove(process)
        for file in (process.out_file, process.err_file):
            os.unlink(file.name)
            file.close()


@attack("full-disk", "a recording, an export and a calibration on a disk that is full")
def full_disk(ground):
    disk = ground.folder / "disk"
    disk.mkdir()
    mounted = (
        subprocess.run(["mount", "-t", "tmpfs", "-o", "size=2m", "tmpfs", disk], capture_output=True).returncode == 0
    )
    try:
        how = "a tmpfs of 2 MB" if mounted else "ulimit -f of 2 MB"

        def limit(most=2_000_000):
            signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
            resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))

        keywords = {} if mounted else {"preexec": limit}
        for question in (["record"], ["run", "--headless"]):
            outside = full(ground, disk, how, question, keywords)
        if mounted:
            # All but a few pages.
            (disk / "other").write_bytes(bytes(1_800_000))
        else:
            keywords = {"preexec": lambda: limit(200_000)}
        exported = ground.ask("export", outside, "--out", disk / "table.csv", **keywords)
        left = [name for name in os.listdir(disk) if "table" in name]
        check(exported.code == 1 and not left, f"export ended with {exported.code}, {left}")
        ground.say(f"export: status 1, nothing under its name: {exported.err().strip()[-160:]}")
    finally:
        if mounted:
            subprocess.run(["umount", disk], check=False)


def full(ground, disk, how, question, keywords):
    """A recording that fills the disk, and its recovery to another disk."""
    target, partial = disk / "full.mcap", disk / "full.partial.mcap"
    name = "--out" if question == ["record"] else "--record"
    frames = 1500
    asked = ground.ask(*question, "ionic-disc", "--speed", 0, "--frames", frames, name, target, timeout=200, **keywords)
    check(asked.code == 3, f"ended with {asked.code}: {asked.err()[-400:]}")
    check(not target.exists() and partial.exists(), f"left {os.listdir(disk)}")
    lost = re.search(r"not_recorded=(\d+)", asked.err())
    check(lost and int(lost[1]) > 0, f"the count is not said: {asked.err()[-400:]}")
    if question != ["record"]:
        shown = asked.out().count("\n")
        check(shown == frames, f"the stream stopped after {shown} frames")
    said = ground.ask("info", partial).out()
    why = re.search(r"stopped: .*(space|large|full).*", said)
    check(why, f"info does not say why: {said[:600]}")
    outside = ground.folder / "saved.mcap"
    outside.unlink(missing_ok=True)
    recovered = ground.ask("recover", partial, "--out", outside)
    kept = info(ground, outside)["frames"]
    check(recovered.code in (0, 3) and kept > 0, f"recover ended with {recovered.code}: {recovered.err()[-300:]}")
    taken = frames if question != ["record"] else kept + int(lost[1])
    check(kept + int(lost[1]) >= taken, f"{kept} frames recovered, {lost[1]} said lost, of {taken}")
    ground.say(
        f"{' '.join(question)}, {how}: status 3, {kept} frames recovered, {lost[1]} said to be missing;"
        f" info: {why[0][:100]}"
    )
    partial.unlink()
    return outside


@attack("escapes", "escape sequences in the names of files, skins, instruments and in texts of recordings")
def escapes(ground):
    evil = "\x1b]0;owned\x07\x1b[2J\x9b31m\u202eevil"
    show = ground.ask("skins", "show", "ionic-disc").out()
    tried = 0
    for questions in (
        ["run", evil, "--headless"],
        ["run", "ionic-disc", "--headless", "--source", evil],
        ["info", evil],
        ["recover", evil, "--out", f"x{evil}.mcap"],
        ["export", evil, "--out", evil],
        ["run", "ionic-disc", "--source", f"tcp:{evil}:1", "--headless"],
        ["doctor", evil],
        [evil],
        ["run", f"--{evil}"],
        ["reproduce", evil],
        ["design", evil],
    ):
        asked = ground.ask(*questions)
        tried += 1
        plain(asked)
        check(asked.code != 0, f"{asked.name!r}: went well")
    for key, value in {"title": evil, "name": "x" + evil, "instrument": evil}.items():
        line = f"{key} = {json.dumps(value)}"
        text = re.sub(rf"(?m)^{key} = .*$", lambda _, line=line: line, show, count=1)
        path = ground.skin(f"evil-{key}.toml", text)
        for question in (["skins", "show", path], ["run", path, "--headless", "--frames", 1, "--speed", 0]):
            plain(ground.ask(*question))
            tried += 1
    evil_file = ground.folder / f"press{evil.replace('/', '')}.mcap"
    made = ground.ask("record", "ionic-disc", "--speed", 0, "--frames", 40, "--out", evil_file)
    check(made.code == 0, f"record ended with {made.code}: {made.err()[-300:]}")
    for question in (["info", evil_file], ["replay", evil_file], ["recover", evil_file, "--out", "r.mcap"]):
        plain(ground.ask(*question))
        tried += 1
    served = ground.start("twin", "serve", "ionic-disc", "--tcp", "127.0.0.1:0", stdin=True)
    served.port()
    served.type(evil + "\n" + f'{{"press": {{"x_mm": "{evil}"}}}}\n')
    served.until("expected")
    served.kill()
    plain(served)
    ground.say(f"{tried + 1} commands: no control character reached the terminal")


def plain(process):
    text = process.out() + process.err()
    bad = [c for c in text if (ord(c) < 32 and c not in "\n\t\r") or 127 <= ord(c) < 160]
    check(not bad, f"{process.name!r}: wrote {bad[:5]!r}: {text[:200]!r}")


@attack("signals", "SIGINT, SIGTERM and SIGHUP at 60 random moments of a run that records")
def signals(ground):
    outcome = {}
    for k in range(60):
        target = ground.folder / f"signal-{k}.mcap"
        command = ground.start("run", "ionic-disc", "--no-open", "--port", 0, "--record", target)
        page = None
        if k % 2:
            page = Page(command.url(), acknowledges=k % 4 == 1)
        time.sleep(ground.random.uniform(0, 3.0))
        number = ground.random.choice([signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
        command.signal(number)
        if ground.random.random() < 0.5:
            time.sleep(ground.random.uniform(0, 0.05))
            command.signal(number)
        asked = time.monotonic()
        command.wait(20)
        took = time.monotonic() - asked
        check(took < 5, f"signal {k}: went on for {took:.1f} s")
        partial = target.with_name(f"signal-{k}.partial.mcap")
        check(not partial.exists(), f"{signal.Signals(number).name} {k}: a partial stays, ended with {command.code}")
        if target.exists():
            check(info(ground, target)["whole"], f"signal {k}: the recording is incomplete")
        key = f"{command.code} {'recording whole' if target.exists() else 'no recording yet'}"
        outcome[key] = outcome.get(key, 0) + 1
        if page:
            page.close()
    ground.say(f"60 signals: {outcome}")
