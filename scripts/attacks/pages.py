"""Clients that reach the page: half-open connections, floods, strangers, meaningless messages."""

import json
import math
import resource
import socket
import time

from .tools import Page, attack, check, connect, open_descriptors, shake_hands


def running(ground, *more, **keywords):
    command = ground.start("run", "ionic-disc", "--no-open", "--port", 0, *more, **keywords)
    return command, command.url()


@attack("half-open", "633 connections to the page that send half a header or nothing")
def half_open(ground):
    command, address = running(ground)
    before = open_descriptors(command.pid)
    half_opened(ground, command, address, 633)
    time.sleep(12)
    left = open_descriptors(command.pid) - before
    ground.say(f"12 s later {left} of 633 connections are left besides the page's")
    check(left < 20, f"{left} descriptors are left")


@attack("half-open-256", "300 of them, with a limit of 256 file descriptors")
def half_open_256(ground):
    limit = lambda: resource.setrlimit(resource.RLIMIT_NOFILE, (256, 256))  # noqa: E731
    command, address = running(ground, preexec=limit)
    half_opened(ground, command, address, 300)


def half_opened(ground, command, address, count):
    page = Page(address)
    page.runs()
    begun = time.monotonic()
    stuck = []
    for k in range(count):
        connection = socket.socket()
        connection.settimeout(2)
        connection.connect(address)
        try:
            connection.sendall([b"", b"GET / HTTP/1.1\r\n", b"GET /ws HTTP/1.1\r\nHost: x\r\n", b"\x16\x03\x01"][k % 4])
        except OSError:
            pass
        stuck.append(connection)
    most = open_descriptors(command.pid)
    second = Page(address)
    second.runs()
    check(not page.ended, "the page that was already open was disconnected")
    gap = page.gap(begun)
    ground.say(
        f"{count} half-open connections: {most} descriptors at most, a new page is served,"
        f" no state for {gap:.2f} s at most"
    )
    check(most < 150, f"{most} descriptors are open")
    check(gap < 1.5, f"no state for {gap:.2f} s")
    for connection in stuck:
        connection.close()
    second.close()


@attack("floods", "acknowledgements, pings, pongs and requests without end, messages of 1 MB, binary ones")
def floods(ground):
    command, address = running(ground)
    good = Page(address)
    good.runs()
    begun = time.monotonic()
    kinds = {
        "acknowledgements": (lambda page: page.frame(b'{"v": 1, "ack": 1}'), 1008),
        "pings": (lambda page: page.frame(b"x" * 125, kind=9), 1008),
        "pongs": (lambda page: page.frame(b"x" * 125, kind=10), 1008),
        "requests": (lambda page: page.frame(b'{"v": 1, "id": 1, "command": {"tare": {"force": false}}}'), 1008),
        "messages of 1 MB": (lambda page: page.frame(b" " * 1_000_000), 1009),
        "binary messages": (lambda page: page.frame(b"x" * 100, kind=2), 1003),
    }
    for what, (send, code) in kinds.items():
        page = Page(address)
        sent = 0
        try:
            while not page.ended and sent < 200_000:
                send(page)
                sent += 1
        except OSError:
            pass
        end = time.monotonic() + 5
        while not page.ended and time.monotonic() < end:
            time.sleep(0.01)
        ground.say(f"{what}: closed with {page.close_code} after {sent} or fewer")
        check(page.ended, f"{what}: {sent} were taken")
        # A close frame may be lost if the sender has filled the line.
        check(page.close_code in (code, None), f"{what}: closed with {page.close_code} and not {code}")
        check(sent < 200_000, f"{what}: {sent} were taken")
        page.close()
    gap = good.gap(begun)
    check(command.poll() is None and not good.ended, f"the command ended with {command.code}")
    ground.say(f"the well-behaved page got a state at least every {gap:.2f} s; {command.memory_mb():.0f} MB")
    check(gap < 1.5, f"no state for {gap:.2f} s")


@attack("origins", "requests from other sites: origins, hosts, methods, paths, tokens")
def origins(ground):
    command, (host, port) = running(ground)
    own = f"{host}:{port}"
    expected = [
        (own, f"http://{own}", "/ws", 101),
        (own, f"https://{own}", "/ws", 403),
        (own, "https://evil.example", "/ws", 403),
        (own, "http://evil.example", "/ws", 403),
        (own, "null", "/ws", 403),
        (own, None, "/ws", 403),
        (own, f"http://{host}:{port + 1}", "/ws", 403),
        (own, f"http://{own}.evil.example", "/ws", 403),
        (f"evil.example:{port}", f"http://evil.example:{port}", "/ws", 403),
        (f"{host}.evil.example:{port}", f"http://{own}", "/ws", 403),
        (f"evil@{own}", f"http://{own}", "/ws", 403),
        (own, f"http://{own}", "/../../../etc/passwd", 404),
        (own, f"http://{own}", "/%2e%2e/%2e%2e/etc/passwd", 404),
        (own, f"http://{own}", "//etc/passwd", 404),
    ]
    for named, origin, path, status in expected:
        with connect(port) as connection:
            got, _ = shake_hands(connection, named, origin, path)
        # Malformed requests are refused before their host is checked.
        check(got == status or (status != 101 and got in (400, 403, 404, 421)), f"{named}, {origin}, {path}: {got}")
    for method in ("POST", "PUT", "DELETE", "TRACE", "CONNECT", "OPTIONS"):
        with connect(port) as connection:
            connection.sendall(f"{method} / HTTP/1.1\r\nHost: {own}\r\nContent-Length: 0\r\n\r\n".encode())
            got = int(connection.recv(4096).split()[1])
        check(got in (400, 403, 404, 405), f"{method}: {got}")
    ground.say(f"{len(expected) - 1} strange requests and 6 methods refused, the page's own taken")
    check(command.poll() is None, f"the command ended with {command.code}")


@attack("messages", "20,000 fuzzed messages of pages")
def messages(ground):
    command = ground.start("run", "healing-square", "--no-open", "--port", 0)
    address = command.url()
    good = Page(address)
    good.runs()
    begun, memory = time.monotonic(), command.memory_mb()
    rng = ground.random
    valid = [
        {"tare": {"force": True}},
        "record_start",
        "record_stop",
        {"hyperparameter": 0.01},
        {"press": {"pointer_id": 1, "x_mm": 2.5, "y_mm": -4, "radius_mm": 10, "pressure_kpa": 80}},
        {"move": {"pointer_id": 1, "x_mm": 2.5, "y_mm": -4, "radius_mm": 10, "pressure_kpa": 80}},
        {"release": {"pointer_id": 1}},
        {"treat": {"cut": {"from_mm": [0, 0], "to_mm": [20, 0]}}},
        {"treat": {"heal": {"at_mm": [10, 0], "radius_mm": 20, "temperature_c": 90, "hours": 2}}},
        {"treat": {"time-lapse": 720}},
        {"treat": "renew"},
        {"demonstrate": False},
        {"choose_channels": [0, 5]},
    ]
    odd = [
        math.nan,
        math.inf,
        -math.inf,
        -1,
        0,
        1e-300,
        1e300,
        2**64,
        -(2**70),
        "",
        "x" * 9000,
        None,
        True,
        [],
        {},
        [[]] * 50,
    ]

    def spoilt(value):
        if rng.random() < 0.25:
            return rng.choice(odd)
        if isinstance(value, dict):
            return {(key if rng.random() < 0.95 else key + "x"): spoilt(inner) for key, inner in value.items()}
        if isinstance(value, list):
            return [spoilt(inner) for inner in value] * rng.choice([1, 1, 1, 0, 3])
        return value

    sent = pages = refused = 0
    page = None
    while sent < 20_000:
        if page is None or page.ended:
            refused += len([answer for answer in page.answers if not answer["ok"]]) if page else 0
            page = Page(address)
            pages += 1
        batch = rng.randrange(1, 60)
        for _ in range(batch):
            message = {
                "v": rng.choice([1, 1, 1, 1, 1, 2, None]),
                "id": rng.choice([1, 2, 2**53, -1, "a"]),
                "command": None,
            }
            message["command"] = spoilt(rng.choice(valid))
            data = bytearray(json.dumps(message).encode())
            if rng.random() < 0.3:
                for _ in range(rng.randrange(1, 6)):
                    data[rng.randrange(len(data))] = rng.randrange(256)
            if rng.random() < 0.02:
                data = bytearray(b"[" * 15000)
            try:
                page.frame(bytes(data))
            except OSError:
                break
            sent += 1
        # Below the allowed rate overall.
        time.sleep(batch / 900)
        check(command.poll() is None, f"the command ended with {command.code}: {command.err()[-600:]}")
    page.close()
    time.sleep(3)
    check(not good.ended, f"the well-behaved page was closed: {good.close_code}")
    good.runs(5)
    gap, losses = good.gap(begun), good.losses()
    ground.say(
        f"{sent} messages over {pages} pages, {refused} refused with a reason;"
        f" memory {memory:.0f} to {command.memory_mb():.0f} MB,"
        f" longest time without a state {gap:.2f} s, losses {losses}"
    )
    check(gap < 5, f"no state for {gap:.2f} s")
    check(command.memory_mb() < memory + 400, f"memory grew from {memory:.0f} to {command.memory_mb():.0f} MB")
    check(all(not any(c in name for c in "/\\") for name in [p.name for p in ground.folder.iterdir()]), "odd names")
