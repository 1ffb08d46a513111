"""Invalid arguments give exceptions that say what was expected and what was given; nothing ends the interpreter."""

import os
import pickle
import signal
import threading
import time

import numpy as np
import pytest

import dermis
from dermis import eit


@pytest.mark.parametrize(
    ("sigma", "words"),
    [
        (np.ones(3), r"sigma: expected shape \(\d+,\), one conductivity per element, got shape \(3,\)"),
        (np.ones((2, 2)), r"got shape \(2, 2\)"),
        (np.ones(0), r"got shape \(0,\)"),
        (3.0, r"got shape \(\)"),
        ("copper", "expected real numbers, got an array of <U6"),
        ([None, None], "expected real numbers, got an array of object"),
        (object(), "expected real numbers, got an array of object"),
        ([[1.0], [1.0, 2.0]], "which is not an array"),
        (np.ones(4, complex), "expected real numbers, got an array of complex128"),
        (np.ones(4, bool), "expected real numbers, got an array of bool"),
        (np.ma.masked_array([1.0, 2.0], [True, False]), "a masked array"),
    ],
)
def test_shapes_and_types_are_named(model, sigma, words):
    with pytest.raises(dermis.InputError, match=words) as error:
        model.voltages(sigma)
    assert isinstance(error.value, (dermis.Error, ValueError))


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 0.0, -1.0])
def test_conductivities_that_no_material_has(model, value):
    sigma = model.sigma.copy()
    sigma[5] = value
    with pytest.raises(dermis.InputError, match="conductivity of element 5"):
        model.voltages(sigma)
    with pytest.raises(dermis.InputError, match="row 1: .*element 5"):
        model.voltages_many(np.stack([model.sigma, sigma]))


def test_any_layout_of_numbers_is_taken(disc):
    sigma = disc.sigma * np.linspace(0.5, 2.0, len(disc.sigma))
    expected = disc.voltages(sigma)
    wide = np.zeros(2 * len(sigma))
    wide[::2] = sigma
    unaligned = np.frombuffer(b"x" + sigma.tobytes(), np.uint8)[1:].view(np.float64)
    read_only = sigma.copy()
    read_only.setflags(write=False)
    for same in (wide[::2], sigma.astype(">f8"), unaligned, read_only, sigma[::-1].copy()[::-1], sigma.tolist()):
        np.testing.assert_array_equal(disc.voltages(same), expected)
    stacked = np.asfortranarray(np.stack([sigma, sigma]))
    np.testing.assert_array_equal(disc.voltages_many(stacked)[1], expected)
    ones = np.ones(len(sigma))
    np.testing.assert_array_equal(disc.voltages(ones.astype(np.int16)), disc.voltages(ones.astype(np.float32)))


def test_what_came_in_is_not_changed_and_what_goes_out_is_owned(disc):
    sigma = disc.sigma.copy()
    voltages = disc.voltages(sigma)
    np.testing.assert_array_equal(sigma, disc.sigma)
    voltages[:] = 0.0
    assert disc.voltages(sigma).any()
    with pytest.raises(ValueError):
        disc.sigma[0] = 1.0


def test_zero_rows_are_zero_rows(disc):
    assert disc.voltages_many(np.empty((0, len(disc.sigma)))).shape == (0, len(disc.voltages()))
    assert disc.image(disc.voltages(), np.empty((0, len(disc.voltages())))).shape[0] == 0
    with pytest.raises(dermis.Error, match="baseline"):
        disc.image(np.empty((0, len(disc.voltages()))), disc.voltages())


def test_threads_are_a_number_of_threads(disc):
    for threads in (0, 10**6):
        with pytest.raises(dermis.InputError, match="threads"):
            disc.voltages_many(disc.sigma[None], threads=threads)
    with pytest.raises((OverflowError, TypeError)):
        disc.voltages_many(disc.sigma[None], threads=-1)


def test_frames_of_another_skin(skin):
    pipe = dermis.Pipeline(skin)
    with pytest.raises(dermis.InputError, match=r"shape \(208,\), one reading per channel of skin healing-square"):
        pipe.process(np.ones(64))
    with pytest.raises(dermis.InputError, match="208 readings"):
        pipe.process(dermis.Frame(np.ones(3)))
    with pytest.raises(dermis.InputError, match="model: expected one of skin healing-square, got one of skin hydrogel-disc"):
        pipe.check_model(dermis.Skin("hydrogel-disc").model(elements=400))
    for value in (np.inf, -np.inf):
        frame = np.ones(208)
        frame[7] = value
        with pytest.raises(dermis.InputError, match="channel 7"):
            pipe.process(frame)
    # A frame of missing values is still a frame.
    assert not pipe.process(np.full(208, np.nan)).ready
    with pytest.raises(dermis.InputError, match="time_s"):
        pipe.process(np.ones(208), time_s=-1.0)


def test_skins_that_are_none():
    with pytest.raises(dermis.SkinError, match="no-such-skin"):
        dermis.Skin("no-such-skin")
    with pytest.raises(dermis.SkinError, match="expected"):
        dermis.Skin('name = "x"\n[frontend]\nbroken = 1\n')
    with pytest.raises(dermis.InputError, match="a dermis.Skin, the name"):
        dermis.Skin(3)
    with pytest.raises((dermis.SkinError, dermis.FileError)):
        dermis.Skin("/")
    with pytest.raises(dermis.Error):
        dermis.Skin("a\0b")
    with pytest.raises(dermis.SkinError, match="elements"):
        dermis.Skin("healing-square").model(elements=0)


def test_presses_that_make_no_sense(skin):
    twin = dermis.Twin(skin)
    for wrong in ({"x_mm": 1e3}, {"y_mm": np.nan}, {"radius_mm": -1}, {"force_n": -1.0}, {"radius_mm": 1e6}):
        with pytest.raises(dermis.InputError, match="expected"):
            twin.press(**{"x_mm": 0, "y_mm": 0, **wrong})
    with pytest.raises(dermis.InputError, match="both"):
        twin.press(0, 0, force_n=1, pressure_kpa=1)
    for dt_s in (0.0, -1.0, np.nan, 1e9):
        with pytest.raises(dermis.InputError, match="dt_s"):
            twin.step(dt_s)


def test_presses_of_sessions_that_make_no_sense():
    with dermis.open("twin:healing-square", frames=3) as session:
        for wrong in ({"x_mm": 1e3}, {"y_mm": np.nan}, {"radius_mm": 0.0}, {"force_n": -1.0}, {"force_n": 1.0, "pressure_kpa": 1.0}):
            with pytest.raises(dermis.InputError, match="expected"):
                session.press(**{"x_mm": 0, "y_mm": 0, **wrong})


def test_a_session_after_its_end():
    with dermis.open("twin:healing-square", frames=3) as session:
        assert sum(1 for _ in session) == 3
        assert session.counters["frames"] == 3
        assert list(session) == []
    assert session.closed
    with pytest.raises(dermis.SessionError, match="expected an open session, got one that is closed"):
        next(session)
    session.close()
    with pytest.raises(dermis.Error):
        dermis.open("no/such/file.csv")
    with pytest.raises(dermis.Error, match="serial"):
        dermis.open("serial:/dev/no-such-port")
    with pytest.raises(dermis.InputError, match="speed"):
        dermis.open("twin", speed=-1)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")
def test_after_a_fork(disc):
    """The child has none of the parent's threads: a session reports this, and everything else uses its own
    threads."""
    disc.voltages_many(np.stack([disc.sigma] * 8))
    expected = disc.voltages()
    session = dermis.open("twin:healing-square", frames=50)
    next(session)
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        said = ""
        try:
            next(session)
        except dermis.SessionError as error:
            said = str(error)
        except BaseException as error:
            said = f"another: {error!r}"
        same = bool((disc.voltages_many(np.stack([disc.sigma] * 8)) == expected).all())
        shape = dermis.Skin("hydrogel-disc").model(elements=300).image(expected, expected).shape
        os.write(writer, pickle.dumps((said, same, shape)))
        os._exit(0)
    os.close(writer)
    deadline = time.monotonic() + 120
    while os.waitpid(child, os.WNOHANG)[0] == 0:
        if time.monotonic() > deadline:
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
            pytest.fail("the child hangs")
        time.sleep(0.05)
    said, same, shape = pickle.loads(os.read(reader, 65536))
    assert "forked" in said and same and len(shape) == 2
    next(session)
    session.close()


def test_a_panic_is_an_exception():
    with pytest.raises(dermis.InternalError, match="a test asked for this"):
        dermis._dermis._panic()


def test_several_threads_at_once(disc):
    expected, wrong = disc.voltages(), []

    def work():
        for _ in range(5):
            if not (disc.voltages(disc.sigma) == expected).all():
                wrong.append(1)

    threads = [threading.Thread(target=work) for _ in range(4)]
    [thread.start() for thread in threads]
    [thread.join() for thread in threads]
    assert not wrong


def test_one_pipeline_from_several_threads(skin):
    pipe, failed = dermis.Pipeline(skin), []
    frame = dermis.Twin(skin).step().values

    def work():
        try:
            for _ in range(20):
                pipe.process(frame)
        except dermis.Error as error:
            failed.append(error)

    threads = [threading.Thread(target=work) for _ in range(4)]
    [thread.start() for thread in threads]
    [thread.join() for thread in threads]
    assert not failed and pipe.frames == 80


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")
def test_a_session_in_a_forked_process_while_a_thread_uses_it():
    """A lock of the session that another thread held at the fork is never released, so nothing may wait for it."""
    with dermis.open("twin:healing-square") as session:
        busy = threading.Thread(target=lambda: [next(session) for _ in range(400)])
        busy.start()
        next(session)
        children = []
        for _ in range(5):
            child = os.fork()
            if child == 0:
                wrong = 0
                for call in (lambda: next(session), session.tare, session.asnumpy, lambda: session.counters, lambda: session.show(browser=False)):
                    try:
                        call()
                        wrong += 1
                    except dermis.SessionError as error:
                        wrong += "forked" not in str(error)
                wrong += not session.closed
                session.close()
                os._exit(wrong)
            children.append(child)
        for child in children:
            assert exit_of(child) == 0
        busy.join()
        next(session)


def exit_of(child, seconds=120):
    """The exit code of a child process; a hanging one is killed."""
    deadline = time.monotonic() + seconds
    while True:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status)
        if time.monotonic() > deadline:
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
            pytest.fail("the child hangs")
        time.sleep(0.02)


def test_one_session_from_several_threads():
    """Every frame goes to one thread, and none is lost."""
    seen = []
    with dermis.open("twin:healing-square", frames=120) as session:

        def work():
            for result in session:
                seen.append(result.sequence)

        threads = [threading.Thread(target=work) for _ in range(4)]
        [thread.start() for thread in threads]
        [thread.join() for thread in threads]
    assert sorted(seen) == sorted(set(seen)) and len(seen) == 120


def test_a_session_closed_by_another_thread():
    session = dermis.open("twin:healing-square")
    said = []

    def work():
        try:
            for _ in session:
                pass
        except dermis.SessionError as error:
            said.append(str(error))

    thread = threading.Thread(target=work)
    thread.start()
    next(session)
    session.close()
    thread.join(timeout=60)
    assert not thread.is_alive() and "closed" in said[0]


def test_recordings_that_are_none(tmp_path):
    path = tmp_path / "x.mcap"
    path.write_bytes(b"not an mcap")
    with pytest.raises(dermis.FileError, match="x.mcap"):
        dermis.Recording(path)
    with pytest.raises(OSError, match="none.mcap"):
        dermis.Recording(tmp_path / "none.mcap")


def test_calibrations_that_cannot_be(skin):
    with pytest.raises(dermis.InputError, match=r"positions_m: .*shape \(n, 2\)"):
        dermis.calibrate(skin, np.ones(208), np.ones((4, 208)), np.ones((4, 3)))
    with pytest.raises(dermis.InputError, match="positions of pokes: expected 4"):
        dermis.calibrate(skin, np.ones(208), np.ones((4, 208)), np.zeros((3, 2)))
    with pytest.raises(dermis.InputError, match=r"nan at \[1, 0\]|NaN at \[1, 0\]"):
        dermis.calibrate(skin, np.ones(208), np.ones((2, 208)), [[0, 0], [np.nan, 0]])


def test_meshes_that_cannot_be():
    nodes = [[0, 0], [1, 0], [1, 1], [0, 1]]
    with pytest.raises(dermis.InputError, match=r"indices of nodes, 0 to 3, got 9 at \[0, 2\]"):
        eit.Mesh(nodes, [[0, 1, 9]])
    with pytest.raises(dermis.InputError, match=r"-1 at \[0, 2\]"):
        eit.Mesh(nodes, [[0, 1, -1]])
    with pytest.raises(dermis.InputError, match="expected whole numbers"):
        eit.Mesh(nodes, [[0.0, 1.0, 2.5]])
    with pytest.raises(dermis.InputError, match=r"shape \(m, 3\) or \(m, 4\)"):
        eit.Mesh(nodes, [[0, 1]])
    with pytest.raises(dermis.InputError, match="not finite"):
        eit.Mesh([[0, 0], [1, 0], [np.nan, 1]], [[0, 1, 2]])
    with pytest.raises(dermis.InputError):
        eit.Mesh(np.empty((0, 2)), np.empty((0, 3), int))
    mesh = eit.Mesh(nodes, [[0, 1, 2], [0, 2, 3]])
    with pytest.raises(dermis.InputError, match="electrode 0"):
        eit.ForwardModel(mesh, [eit.Electrode.edges([[0, 2000]], 0.1), eit.Electrode.point(0)], eit.Protocol.adjacent(4))
    with pytest.raises(dermis.InputError, match="carries 2 electrodes"):
        eit.ForwardModel(mesh, eit.points([0, 2]), eit.Protocol.adjacent(4))
    with pytest.raises(dermis.InputError, match="opposite drive needs"):
        eit.Protocol.generate(7, "opposite")
    with pytest.raises(dermis.InputError, match="drive: expected"):
        eit.Protocol.generate(8, "sideways")
    with pytest.raises(TypeError):
        eit.ForwardModel(mesh, [1, 2], eit.Protocol.adjacent(4))


def test_what_nests_is_refused_before_the_stack_ends():
    prior = eit.Prior.laplace()
    for _ in range(16):
        prior = eit.Prior.mixture([(1.0, prior)])
    with pytest.raises(dermis.InputError, match="at most 16 deep"):
        eit.Prior.mixture([(1.0, prior)])
    model = dermis.Skin("healing-square").model()
    choice = "laplace"
    for _ in range(20_000):
        choice = {"mixture": choice}
    with pytest.raises(dermis.Error):
        model.image(model.voltages(), model.voltages(), prior=choice)
    while isinstance(choice, dict):
        choice = choice.pop("mixture")


def test_a_sphere_of_any_radius_takes_the_same_time():
    from dermis import mit

    begun = time.monotonic()
    for radius_m in (1e-5, 1e-2, 1.0, 1e2, 1e5):
        body = mit.Body.sphere(radius_m, 6e7, 1e6)
        assert np.isfinite(body.tau).all()
    assert time.monotonic() - begun < 0.2


def test_counts_of_electrodes_are_checked_before_work():
    mesh = eit.Mesh([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]], [[0, 1, 2]])
    for count in (0, -1, 10**9):
        with pytest.raises(dermis.InputError, match="count: expected 1 to 512"):
            eit.ring_electrodes(mesh, count, 0.1, 0.1)


def test_protocols_of_pyeit_with_other_shapes_are_told_theirs():
    class Protocol:
        ex_mat = np.array([[0, 1], [1, 2]])
        meas_mat = np.array([[2, 3], [3, 0]])

    with pytest.raises(dermis.InputError, match="meas_mat: expected shape"):
        eit.protocol_from_pyeit(Protocol)


def test_what_is_echoed_is_short_and_harmless():
    for text in ("x" * 10_000, "\x1b[31mred\x07" * 100, "a\rb"):
        with pytest.raises(dermis.Error) as caught:
            eit.Protocol.generate(8, text)
        said = str(caught.value)
        assert len(said) < 2500 and not any(ord(letter) < 32 and letter != "\n" for letter in said), said
