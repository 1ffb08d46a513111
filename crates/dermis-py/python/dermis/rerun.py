"""Sessions and recordings in the Rerun viewer (https://rerun.io).

:func:`save` writes a file that the viewer opens, :func:`log` sends to a viewer that is running, and :class:`SkinLog`
takes results one by one. The skin's surface is logged once; each frame adds its colours, touches with their standard
deviations, forces and health. rerun-sdk is imported only when something is logged.

========================  ===========================================================================================
entity                    content
========================  ===========================================================================================
``skin/surface``          mesh of the image's pixels, on the cylinder of a bent skin; colours of each frame
``skin/outline``          the rim
``skin/touches``          touches as points, with identity and force
``skin/sigma``            ellipses of one standard deviation about them
``skin/forces``           arrows that end at the touches: forces on the sensor
``skin/plots/force_n``    sum of the touches' forces, newtons; NaN while one is unknown
``skin/plots/touches``    number of touches
``skin/plots/peak``       largest magnitude of the image
``skin/plots/scale``      magnitude that has full colour
``skin/plots/left_out``   number of channels left out
``skin/health``           a line whenever the health changes, or frames are lost
========================  ===========================================================================================

Lengths are in metres, in the patch's frame. The timelines are those of the frames: ``frame`` (sequence number),
``time`` (seconds on the source's clock) and ``wall`` (the host's wall clock when the frame arrived, also in
recordings).
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _dermis, _surface
from ._checks import check_positive
from ._dermis import Recording, Result, Session, Skin
from ._pixel_mesh import PixelMesh, colours_of
from .contacts import spatial
from .errors import FileError, InputError

if TYPE_CHECKING:
    import rerun.blueprint as rrb

    _Source = Session | Recording | str | os.PathLike[str] | Iterable[Result]

__all__ = ["SkinLog", "log", "save"]

_APPLICATION = "dermis"

_NOISE_SCALE = 10.0
"""Full colour in multiples of the largest value at rest, until something presses."""

_MM_PER_N = 10.0
"""Default length of a force arrow."""

_TOUCH_MM = 1.0
"""Radius of a touch's point."""

_ARROW_MM = 0.5
"""Radius of a force arrow."""

_FLAT_MM = 0.2
"""Half thickness of the ellipses of sigma: they lie in the skin and have no height."""

_MARK = (20, 20, 20)
_FORCE = (255, 170, 0)


def save(
    source: _Source,
    path: str | os.PathLike[str],
    *,
    skin: Skin | str | None = None,
    entity: str = "skin",
    root_from_patch: ArrayLike | None = None,
    full_scale: float | None = None,
    mm_per_n: float = _MM_PER_N,
    frames: int | None = None,
) -> int:
    """Writes a session or a recording as a file of the Rerun viewer, with a layout for it.

    Parameters
    ----------
    source : Session, Recording, str, os.PathLike, or iterable of Result
        A session, which is run to its end; a recording, which is replayed; anything that :func:`dermis.open` opens; or
        results.
    path : str or os.PathLike
        The file, usually ``.rrd``. It appears under this name only when complete.
    skin : Skin or str, optional
        The skin, if the source doesn't name it.
    entity : str
        Entity of the skin; several skins of one file need different ones.
    root_from_patch : array_like, optional
        Shape (4, 4): transform from the patch's frame to the root's, metres.
    full_scale : float, optional
        Magnitude of the image that has full colour; default: the largest so far, which never falls. It is logged as
        ``plots/scale``.
    mm_per_n : float
        Length of force arrows.
    frames : int, optional
        Stop after this many frames.

    Returns
    -------
    int
        Number of frames written.

    Raises
    ------
    InputError
        An argument or the source is invalid.
    FileError
        The file cannot be written.
    ImportError
        rerun-sdk is not installed.

    Examples
    --------
    >>> import dermis
    >>> from dermis.rerun import save
    >>> save(dermis.open("twin:healing-square", frames=50), "press.rrd")                # doctest: +SKIP
    50
    """
    import rerun

    target = Path(path)
    if not target.parent.is_dir():
        raise FileError(f"path = {str(target)!r}: expected a file in an existing folder")
    stream = rerun.RecordingStream(_APPLICATION)
    # The frames' own clocks are the only timelines.
    stream.set_log_time_enabled(False)
    stream.set_log_tick_enabled(False)
    results, of, walls = _results(source, skin, frames)
    logger = SkinLog(
        of, stream, entity=entity, root_from_patch=root_from_patch, full_scale=full_scale, mm_per_n=mm_per_n
    )
    partial = target.with_name(f"{target.name}.part")
    try:
        stream.save(partial, default_blueprint=logger.blueprint())
    except Exception as error:
        raise FileError(f"{target}: {error}") from error
    try:
        count = logger.log_all(results, frames=frames, wall_ns=walls)
        stream.disconnect()
        os.replace(partial, target)
    except BaseException:
        stream.disconnect()
        partial.unlink(missing_ok=True)
        raise
    return count


def log(
    source: _Source,
    stream: Any = None,
    *,
    skin: Skin | str | None = None,
    entity: str = "skin",
    root_from_patch: ArrayLike | None = None,
    full_scale: float | None = None,
    mm_per_n: float = _MM_PER_N,
    frames: int | None = None,
) -> int:
    """Logs a session or a recording to a stream of Rerun, with a layout for it.

    Parameters
    ----------
    source : Session, Recording, str, os.PathLike, or iterable of Result
        As for :func:`save`.
    stream : rerun.RecordingStream, optional
        Stream to log to; default: the one set up by ``rerun.init``.
    skin : Skin or str, optional
        The skin, if the source doesn't name it.
    entity : str
        Entity of the skin; several skins on one stream need different ones.
    root_from_patch : array_like, optional
        Shape (4, 4): transform from the patch's frame to the root's, metres.
    full_scale : float, optional
        Magnitude of the image that has full colour; default: the largest so far.
    mm_per_n : float
        Length of force arrows.
    frames : int, optional
        Stop after this many frames.

    Returns
    -------
    int
        Number of frames logged.

    Raises
    ------
    InputError
        An argument or the source is invalid.
    ImportError
        rerun-sdk is not installed.

    Examples
    --------
    >>> import dermis, rerun                                                            # doctest: +SKIP
    >>> from dermis.rerun import log
    >>> rerun.init("press", spawn=True)                                                 # doctest: +SKIP
    >>> log(dermis.open("twin:healing-square", frames=500, speed=1))                    # doctest: +SKIP
    500
    """
    results, of, walls = _results(source, skin, frames)
    logger = SkinLog(
        of, stream, entity=entity, root_from_patch=root_from_patch, full_scale=full_scale, mm_per_n=mm_per_n
    )
    logger.send_blueprint()
    return logger.log_all(results, frames=frames, wall_ns=walls)


class SkinLog:
    """Logs the results of one skin, one by one.

    Parameters
    ----------
    skin : Skin or str
        The skin.
    stream : rerun.RecordingStream, optional
        Stream to log to; default: the one set up by ``rerun.init``.
    entity : str
        Entity of the skin.
    root_from_patch : array_like, optional
        Shape (4, 4): transform from the patch's frame to the root's, metres.
    full_scale : float, optional
        Magnitude of the image that has full colour; default: the largest so far.
    mm_per_n : float
        Length of force arrows.

    Raises
    ------
    InputError
        An argument is invalid; the message names it.
    ImportError
        rerun-sdk is not installed.
    """

    def __init__(
        self,
        skin: Skin | str,
        stream: Any = None,
        *,
        entity: str = "skin",
        root_from_patch: ArrayLike | None = None,
        full_scale: float | None = None,
        mm_per_n: float = _MM_PER_N,
    ) -> None:
        import rerun

        self._rerun: Any = rerun
        self.skin = Skin(skin)
        if stream is not None and not isinstance(stream, rerun.RecordingStream):
            raise InputError(f"stream: expected a rerun.RecordingStream, got {type(stream).__name__}")
        if not (isinstance(entity, str) and entity.strip("/")):
            raise InputError(f"entity = {entity!r}: expected a path such as 'skin' or 'robot/palm'")
        if full_scale is not None:
            check_positive("full_scale", full_scale, "a number")
        check_positive("mm_per_n", mm_per_n, "a number")
        self.entity = entity.strip("/")
        self._stream = stream
        self._mm_per_n = mm_per_n
        self._full_scale = full_scale
        self._scale = 0.0 if full_scale is None else float(full_scale)
        self._mesh: PixelMesh | None = None
        self._state: str | None = None
        self._lost: dict[str, int] = {}
        self._draw_rest(root_from_patch)

    def log(self, result: Result, *, wall_ns: int | None = None) -> None:
        """Logs one result.

        Parameters
        ----------
        result : Result
            A result of the skin's pipeline or session.
        wall_ns : int, optional
            Its wall-clock time; default: the result's, which in a replay is the time of the replay.
        """
        rr = self._rerun
        if not isinstance(result, Result):
            raise InputError(f"result: expected a dermis.Result, got {type(result).__name__}")
        self._set_times(result, result.wall_ns if wall_ns is None else wall_ns)
        if result.ready:
            self._log_surface(result)
            self._log_touches(result)
        self._log_health(result)
        self._send("plots/left_out", rr.Scalars([float(len(result.health["channels"]))]))

    def log_all(
        self, results: Iterable[Result], *, frames: int | None = None, wall_ns: Mapping[int, int] | None = None
    ) -> int:
        """Logs results until they end.

        Parameters
        ----------
        results : iterable of Result
            A session, or any other iterable.
        frames : int, optional
            Stop after this many.
        wall_ns : mapping, optional
            Wall-clock times of frames by their sequence numbers; default: the results'.

        Returns
        -------
        int
            Number of results logged.
        """
        count, walls = 0, wall_ns or {}
        session = results if isinstance(results, Session) else None
        if frames == 0:
            return 0
        for result in results:
            self.log(result, wall_ns=walls.get(result.sequence) if walls else None)
            if session is not None:
                self._log_counters(session.counters)
            count += 1
            if count == frames:
                break
        return count

    def blueprint(self) -> rrb.Blueprint:
        """The layout: the skin in space on the left; forces, image and health on the right.

        Returns
        -------
        rerun.blueprint.Blueprint
            For ``rerun.send_blueprint``.
        """
        import rerun.blueprint as rrb

        of = f"/{self.entity}"
        plots = [
            rrb.TimeSeriesView(origin=of, contents=[f"{of}/plots/{name}" for name in names], name=title)
            for title, names in (
                ("force (N)", ["force_n"]),
                ("image", ["peak", "scale"]),
                ("touches and channels left out", ["touches", "left_out"]),
            )
        ]
        health = rrb.TextLogView(origin=f"{of}/health", name="health")
        return rrb.Blueprint(
            rrb.Horizontal(
                rrb.Spatial3DView(origin="/", contents="/**", name=self.skin.title or self.skin.name),
                rrb.Vertical(*plots, health),
                column_shares=[3, 2],
            ),
            rrb.TimePanel(timeline="time"),
            auto_views=False,
            collapse_panels=True,
        )

    def send_blueprint(self) -> None:
        """Sends the layout to the viewer."""
        self._rerun.send_blueprint(self.blueprint(), recording=self._stream)

    def _send(self, entity: str, archetype: Any, *, static: bool = False) -> None:
        path = f"{self.entity}/{entity}" if entity else self.entity
        self._rerun.log(path, archetype, static=static, recording=self._stream)

    def _draw_rest(self, root_from_patch: ArrayLike | None) -> None:
        """Logs what never changes: mount and rim."""
        rr = self._rerun
        if root_from_patch is not None:
            transform = _transform(root_from_patch)
            self._send("", rr.Transform3D(translation=transform[:3, 3], mat3x3=transform[:3, :3]), static=True)
        rim = np.vstack([self.skin.outline, self.skin.outline[:1]])
        radius_m = self.skin.cylinder_radius_m
        if radius_m is not None:
            # Straight sides bend too.
            share = np.linspace(0.0, 1.0, 16, endpoint=False)[:, None]
            rim = np.vstack([*(a + share * (b - a) for a, b in zip(rim[:-1], rim[1:])), rim[-1:]])
        self._send("outline", rr.LineStrips3D([_surface.points(radius_m, rim)], colors=[_MARK]), static=True)
        names = {"force_n": "force (N)", "peak": "peak", "scale": "full colour", "touches": "touches"}
        for name, title in {**names, "left_out": "channels left out"}.items():
            self._send(f"plots/{name}", rr.SeriesLines(names=title), static=True)

    def _set_times(self, result: Result, wall_ns: int) -> None:
        rr, stream = self._rerun, self._stream
        rr.set_time("frame", sequence=result.sequence, recording=stream)
        rr.set_time("time", duration=result.time_s, recording=stream)
        rr.set_time("wall", timestamp=np.datetime64(wall_ns, "ns"), recording=stream)

    def _log_surface(self, result: Result) -> None:
        rr = self._rerun
        image = np.asarray(result.image, dtype=np.float64)
        inside = np.isfinite(image)
        if not inside.any():
            # Whole frames are faulty and give no image.
            return
        peak = float(np.abs(image[inside]).max())
        if self._full_scale is None:
            self._scale = max(self._scale, peak if self._scale > 0.0 else _NOISE_SCALE * peak)
        if self._mesh is None:
            self._mesh = PixelMesh(inside, result.extent_mm, self.skin)
            positions, normals = self._mesh.positions_m, self._mesh.normals
            mesh = rr.Mesh3D(vertex_positions=positions, vertex_normals=normals, triangle_indices=self._mesh.triangles)
            self._send("surface", mesh, static=True)
        colours = colours_of(self._mesh.at_vertices(image), self._scale)
        self._send("surface", rr.Mesh3D.from_fields(vertex_colors=colours))
        self._send("plots/peak", rr.Scalars([peak]))
        self._send("plots/scale", rr.Scalars([self._scale]))

    def _log_touches(self, result: Result) -> None:
        rr = self._rerun
        table = result.touches[result.touches["phase"] != "end"]
        touches = spatial(self.skin, table)
        positions = 1e-3 * touches.position_mm
        labels = [str(touch["id"]) + ("" if np.isnan(touch["force_n"]) else f": {touch['force_n']:.2f} N") for touch in table]
        self._send("touches", rr.Points3D(positions, radii=1e-3 * _TOUCH_MM, colors=_MARK, labels=labels))
        sigmas = np.column_stack([table["sigma_x_mm"], table["sigma_y_mm"], np.full(len(table), _FLAT_MM)])
        known = np.isfinite(sigmas).all(axis=1)
        ellipses = rr.Ellipsoids3D(
            centers=positions[known],
            half_sizes=1e-3 * sigmas[known],
            quaternions=_surface.turns(touches.normal[known]),
            colors=_FORCE,
            line_radii=1e-3 * 0.5 * _FLAT_MM,
            fill_mode="densewireframe",
        )
        self._send("sigma", ellipses)
        forces_n = touches.force_n
        known = np.isfinite(forces_n).all(axis=1)
        vectors = 1e-3 * self._mm_per_n * forces_n[known]
        arrows = rr.Arrows3D(origins=positions[known] - vectors, vectors=vectors, radii=1e-3 * _ARROW_MM, colors=_FORCE)
        self._send("forces", arrows)
        self._send("plots/force_n", rr.Scalars([float(table["force_n"].sum())]))
        self._send("plots/touches", rr.Scalars([float(len(table))]))

    def _log_health(self, result: Result) -> None:
        health = result.health
        parts = [f"frames {health['frame']}: touches unknown"] if health["frame"] else []
        if health["channels"]:
            parts.append("channels left out: " + ", ".join(f"{n} {why}" for n, why in health["channels"].items()))
        if health["electrodes"]:
            parts.append("electrodes faulty: " + ", ".join(map(str, health["electrodes"])))
        state = "; ".join(parts) or ("sound" if result.ready else "learning the baseline")
        if state != self._state:
            self._say(state, "WARN" if parts else "INFO")
            self._state = state

    def _log_counters(self, counters: dict[str, int]) -> None:
        lost = {name: counters[name] for name in ("dropped", "lost", "damaged", "repeated") if counters[name]}
        if lost != self._lost:
            self._say(", ".join(f"{count} frames {name}" for name, count in lost.items()), "ERROR")
            self._lost = lost

    def _say(self, text: str, level: str) -> None:
        self._send("health", self._rerun.TextLog(text, level=level))


def _results(
    source: Any, skin: Skin | str | None, frames: int | None
) -> tuple[Iterable[Result], Skin, dict[int, int]]:
    """The results of a source, their skin, and for a recording the wall-clock times of its frames."""
    if frames is not None and (isinstance(frames, bool) or not isinstance(frames, (int, np.integer)) or frames < 0):
        raise InputError(f"frames = {frames!r}: expected a whole number, 0 or more")
    if isinstance(source, Recording):
        source = source.path
    if isinstance(source, (str, os.PathLike)):
        source = _dermis.open(source, skin)
    if isinstance(source, Session):
        return source, source.skin, _recorded_wall_ns(source.source)
    if not isinstance(source, Iterable):
        expected = "a dermis.Session, a dermis.Recording, a source that dermis.open opens, or results"
        raise InputError(f"source: expected {expected}, got {type(source).__name__}")
    if skin is None:
        raise InputError("skin: expected the skin of these results, got none")
    return source, Skin(skin), {}


def _recorded_wall_ns(source: str) -> dict[int, int]:
    """The wall-clock times at which a recording's frames arrived, by sequence number; empty for other sources."""
    if ".mcap" not in source:
        return {}
    try:
        _, wall_ns, sequences = Recording(source).times()
    except FileError:
        # An MCAP file of another program.
        return {}
    return dict(zip(sequences.tolist(), wall_ns.tolist()))


def _transform(values: ArrayLike) -> NDArray[np.float64]:
    try:
        transform = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        transform = np.empty(0)
    if transform.shape != (4, 4) or not np.isfinite(transform).all():
        raise InputError(f"root_from_patch: expected finite numbers of shape (4, 4), got shape {np.shape(values)}")
    turn = transform[:3, :3]
    is_turn = np.allclose(turn @ turn.T, np.eye(3), atol=1e-6) and np.linalg.det(turn) > 0.0
    if not (is_turn and (transform[3] == [0, 0, 0, 1]).all()):
        raise InputError("root_from_patch: expected a rotation and a translation, with the last row 0 0 0 1")
    return transform
