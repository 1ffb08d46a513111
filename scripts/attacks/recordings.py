"""Recordings damaged in transit."""

import os
import re

from .tools import attack, check


@attack("damaged-recordings", "200 damaged recordings: info, recover, replay, export and run of each")
def damaged_recordings(ground):
    good = ground.folder / "good.mcap"
    made = ground.ask("record", "ionic-disc", "--speed", 0, "--frames", 120, "--out", good)
    check(made.code == 0, f"record ended with {made.code}: {made.err()[-300:]}")
    whole = good.read_bytes()
    rng = ground.random
    statuses = {}
    for k in range(200):
        data = bytearray(whole)
        kind = k % 6
        if kind == 0:
            data = data[: rng.randrange(len(data))]
        elif kind == 1:
            for _ in range(rng.randrange(1, 50)):
                data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
        elif kind == 2:
            at = rng.randrange(len(data))
            data[at : at + 8] = rng.choice([b"\xff" * 8, b"\0" * 8, b"\xff" * 7 + b"\x7f"])
        elif kind == 3:
            at, count = rng.randrange(len(data)), rng.randrange(1, 5000)
            data[at : at + count] = b""
        elif kind == 4:
            at, other, count = rng.randrange(len(data)), rng.randrange(len(data)), rng.randrange(1, 50000)
            data[at:at] = data[other : other + count]
        else:
            # Lengths of records, near the beginning.
            at = rng.randrange(8, 4000)
            data[at : at + 8] = rng.randbytes(8)
        damaged = ground.folder / "damaged.mcap"
        damaged.write_bytes(data)
        outcome = []
        for question in (
            ["info", damaged],
            ["recover", damaged, "--out", "again.mcap"],
            ["replay", damaged, "--only-touches"],
            ["export", damaged, "--out", "table.csv"],
            ["run", "--source", damaged, "--headless", "--only-touches", "--speed", "0"],
        ):
            asked = ground.ask(*question, timeout=60)
            asked.check_sound()
            check(asked.code in (0, 1, 2, 3), f"{k}: {asked.name}: ended with {asked.code}: {asked.err()[-300:]}")
            check(asked.peak_mb() < 800, f"{k}: {asked.name}: took {asked.peak_mb():.0f} MB")
            if asked.code in (1, 2):
                check(re.search(r"damaged\.mcap", asked.err()), f"{k}: the error names no file: {asked.err()[-300:]}")
            outcome.append(asked.code)
            if question[0] == "recover" and asked.code in (0, 3):
                again = ground.ask("info", "again.mcap")
                check("state: whole" in again.out(), f"{k}: the recovered recording is incomplete: {again.out()[:300]}")
            ground.processes.remove(asked)
            for file in (asked.out_file, asked.err_file):
                os.unlink(file.name)
                file.close()
        for name in ("again.mcap", "table.csv"):
            (ground.folder / name).unlink(missing_ok=True)
        statuses[tuple(outcome)] = statuses.get(tuple(outcome), 0) + 1
    ground.say(f"200 recordings, statuses of info, recover, replay, export, run: {statuses}")
