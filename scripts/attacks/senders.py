"""Instruments that send invalid data, and silent hosts."""

import math
import random
import re
import struct
import time
import zlib

from .tools import attack, check, connect, open_descriptors, serve
from .wire import HELLO, START, Host

CHANNELS = 208
SKIN = "ionic-disc"


def line(values):
    return (" ".join(f"{value:.6g}" for value in values) + "\n").encode()


def readings(k):
    return [1.0 + 0.001 * ((7 * c + k) % 13) for c in range(CHANNELS)]


def every(seconds, make):
    """A sender that sends `make(k)` at a fixed interval."""

    def talk(connection, _, ended):
        k = 0
        while not ended.is_set():
            connection.sendall(make(k))
            k += 1
            time.sleep(seconds)

    return talk


def flood(chunk):
    """A sender that repeats one chunk as fast as it is accepted."""

    def talk(connection, _, ended):
        while not ended.is_set():
            connection.sendall(chunk)

    return talk


def record(ground, port, instrument, seconds, name="r.mcap"):
    source = f"tcp:127.0.0.1:{port}#{instrument}"
    return ground.start("-v", "record", SKIN, "--source", source, "--seconds", seconds, "--out", ground.folder / name)


@attack("silent-client", "clients that connect to a served twin and say nothing, and a host that wants frames")
def silent_client(ground):
    served = ground.start("twin", "serve", SKIN, "--tcp", "127.0.0.1:0")
    port = served.port()
    silent = [connect(port) for _ in range(7)]
    host = Host(connect(port))
    host.start()
    host.wait_for_frames(20, 20)
    ground.say("7 silent clients: the eighth has frames at once")
    # All places are taken by silent hosts, which are disconnected after five seconds.
    more = [connect(port) for _ in range(20)]
    served.until("disconnected: it sent nothing", 20)
    time.sleep(6)
    late = Host(connect(port))
    late.start()
    late.wait_for_frames(20, 20)
    check(host.missing == 0, f"{host.missing} frames are missing")
    ground.say(f"27 silent clients: disconnected; a host that connects afterwards gets frames, the first one misses {host.missing}")
    for connection in silent + more:
        connection.close()


@attack(
    "stuck-senders",
    "lines with a wrong count of numbers, zeros, one endless line, text, noise: a reason, a new connection, no memory",
)
def stuck_senders(ground):
    noise = random.Random(1).randbytes(1 << 20)
    cases = [
        ("lines with a wrong count", f"lines:{CHANNELS}", every(0.02, lambda k: line(readings(k)[:100]))),
        ("zeros as lines", f"lines:{CHANNELS}", flood(b"\0" * 65536)),
        ("zeros on the wire", "wire", flood(b"\0" * 65536)),
        ("one endless line", f"lines:{CHANNELS}", flood(b"1 " * 32768)),
        ("one endless line on the wire", "wire", flood(b"\x01" * 65536)),
        ("noise on the wire", "wire", flood(noise)),
        ("noise as lines", f"lines:{CHANNELS}", flood(noise)),
        ("a web server", "wire", every(0.05, lambda k: b"HTTP/1.1 400 Bad Request\r\n\r\n<html>")),
    ]
    for what, instrument, talk in cases:
        # If lines are expected, start with valid ones, so that the run gets going.
        port, count, end = serve(begin_well(talk) if instrument.startswith("lines") else talk)
        command = record(ground, port, instrument, 12, f"{what.replace(' ', '-')}.mcap")
        command.wait(60)
        end()
        text = command.err()
        reasons = [line for line in text.splitlines() if "WARN" in line or "ERROR" in line]
        ground.say(
            f"{what}: status {command.code}, {count[0]} connections, {command.peak_mb():.0f} MB,"
            f" {len(reasons)} lines of log,"
            f" {strip(reasons[0]) if reasons else strip(text)[-140:]!r}"
        )
        check(command.code in (1, 2, 3), f"{what}: ended with {command.code}, as if nothing were lost: {text[-300:]}")
        check(command.peak_mb() < 600, f"{what}: took {command.peak_mb():.0f} MB")
        check(count[0] >= 2, f"{what}: there was no new connection: {text[-400:]}")
        check(len(text.splitlines()) < 60, f"{what}: {len(text.splitlines())} lines of log")
        check(
            re.search("no whole frame|damaged|readings|numbers|sends|bytes|hello|describe|answer", text),
            f"{what}: no reason: {text[-300:]}",
        )


def strip(text):
    return re.sub(r"^\S+Z\s+", "", text.strip())[:170]


def begin_well(then):
    def talk(connection, number, ended):
        if number == 1:
            for k in range(60):
                connection.sendall(line(readings(k)))
                time.sleep(0.02)
        then(connection, number, ended)

    return talk


def floats(k):
    return struct.pack(f"<{CHANNELS}f", *readings(k))


@attack("half-floats", "a sender of #floats that stops within frames, with and without the header")
def half_floats(ground):
    instrument = f"floats:{CHANNELS}"
    for is_headed in (False, True):

        def talk(connection, number, ended, is_headed=is_headed):
            for k in range(10**6):
                if ended.is_set():
                    return
                data = floats(k)
                head = struct.pack("<4sHHI", b"DRMF", CHANNELS, k & 0xFFFF, zlib.crc32(data)) if is_headed else b""
                # One in forty stops in the middle, and the next follows directly.
                connection.sendall((head + data)[:320] if k % 40 == 39 else head + data)
                time.sleep(0.02)

        port, count, end = serve(talk)
        name = f"floats-{'header' if is_headed else 'bare'}.mcap"
        command = record(ground, port, instrument, 10, name)
        command.wait(60)
        end()
        text = command.err()
        table = ground.folder / "floats.csv"
        exported = ground.ask("export", ground.folder / name, "--out", table)
        check(exported.code == 0, f"export ended with {exported.code}: {exported.err()[-300:]}")
        rows = [row.split(",") for row in table.read_text().splitlines()]
        first = next(k for k, column in enumerate(rows[0]) if ">" in column or column.startswith("channel"))
        wrong = 0
        for row in rows[1:]:
            values = [float(v) if v else math.nan for v in row[first:]]
            wrong += not any(
                all(abs(v - (1.0 + 0.001 * ((7 * c + k) % 13))) < 1e-4 for c, v in enumerate(values)) for k in range(13)
            )
        damaged = re.search(r"damaged=(\d+)", text)
        ground.say(
            f"{'with' if is_headed else 'without'} header: status {command.code}, {len(rows) - 1} frames,"
            f" {wrong} of them shifted,"
            f" {damaged[1] if damaged else 0} damaged, {count[0]} connections"
        )
        check(command.code == 3, f"ended with {command.code}: {text[-300:]}")
        check(damaged and int(damaged[1]) > 0, f"nothing is counted: {text[-300:]}")
        check(wrong == 0, f"{wrong} frames are shifted")
        check(not is_headed or count[0] == 1, f"with a header, there were {count[0] - 1} new connections")
        table.unlink()


@attack("nan-first", "the first 50 frames without a single reading, as text and as NaN; then good ones")
def nan_first(ground):
    nothing = [math.nan] * CHANNELS

    def lines(connection, number, ended):
        for k in range(10**6):
            if ended.is_set():
                return
            connection.sendall(line(nothing if k < 50 else readings(k)))
            time.sleep(0.02)

    def raw(connection, number, ended):
        for k in range(10**6):
            if ended.is_set():
                return
            connection.sendall(struct.pack(f"<{CHANNELS}f", *nothing) if k < 50 else floats(k))
            time.sleep(0.02)

    for what, instrument, talk in (("lines", f"lines:{CHANNELS}", lines), ("floats", f"floats:{CHANNELS}", raw)):
        port, _, end = serve(talk)
        source = f"tcp:127.0.0.1:{port}#{instrument}"
        command = ground.start("run", SKIN, "--source", source, "--headless", "--frames", 120)
        command.wait(60)
        end()
        check(command.code == 0, f"{what}: ended with {command.code}: {command.err()[-400:]}")
        shown = command.out().count('"touches"')
        ground.say(f"50 NaN frames as {what}: the run goes on, {shown} frames, status {command.code}")
        check(shown == 120, f"{what}: {shown} frames of 120")


@attack("hostile-senders", "32 hostile senders at once, each recorded; and 32 hostile hosts at one served twin")
def hostile_senders(ground):
    rng = ground.random
    noise = rng.randbytes(1 << 16)
    kinds = [
        (f"lines:{CHANNELS}", flood(b"\0" * 65536)),
        (f"lines:{CHANNELS}", flood(noise)),
        ("lines", every(0.01, lambda k: line(readings(k)[: k % 208 + 1]))),
        ("wire", flood(noise)),
        ("wire", flood(b"\0\x01\xff" * 20000)),
        (f"floats:{CHANNELS}", every(0.01, lambda k: noise[: 1 + k % 800])),
        ("wire", every(0.001, lambda k: b"")),
        ("wire", lambda connection, number, ended: connection.close()),
    ]
    commands, ends = [], []
    for k in range(32):
        instrument, talk = kinds[k % len(kinds)]
        port, _, end = serve(talk)
        ends.append(end)
        commands.append(record(ground, port, instrument, 10, f"hostile-{k}.mcap"))
    codes, peak = {}, 0.0
    for command in commands:
        command.wait(180)
        peak = max(peak, command.peak_mb())
        codes[command.code] = codes.get(command.code, 0) + 1
        check(command.code in (0, 1, 2, 3), f"ended with {command.code}: {command.err()[-300:]}")
    for end in ends:
        end()
    ground.say(f"32 senders: statuses {codes}, {peak:.0f} MB at most")
    check(peak < 600, f"took {peak:.0f} MB")
    served = ground.start("twin", "serve", SKIN, "--tcp", "127.0.0.1:0")
    port = served.port()
    good = Host(connect(port))
    good.start()
    good.wait_for_frames(10)
    begun, descriptors = time.monotonic(), open_descriptors(served.pid)
    for k in range(32):
        connection = connect(port)
        try:
            connection.sendall([noise, b"\0" * 65536, HELLO + START + noise, HELLO * 4000][k % 4])
        except OSError:
            pass
        if k % 2:
            connection.close()
    # A host that requests frames and never reads them.
    stuck = connect(port)
    stuck.sendall(HELLO + START)
    time.sleep(8)
    gap = good.gap(begun)
    ground.say(
        f"33 hosts: longest time without a frame of the good one {gap:.2f} s,"
        f" {good.missing} missing, {served.memory_mb():.0f} MB"
    )
    check(served.poll() is None and not good.ended, f"the twin ended with {served.code}: {served.err()[-300:]}")
    check(gap < 1.0 and good.missing == 0, f"no frame for {gap:.2f} s, {good.missing} missing")
    check(open_descriptors(served.pid) < descriptors + 40, "descriptors are not given back")
