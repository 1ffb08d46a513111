"""Skins in MuJoCo: contacts press a skin's twin, and its pipeline finds the touches.

:class:`SkinSensor` covers geoms or bodies of a model with patches of skin. The layer turns MuJoCo's contact points and
forces into pressure, the twin makes the frames that an instrument would send, including noise, and the pipeline finds
touches, in the frame of the patch, its mount, or the world. :mod:`dermis.contacts` does the same without MuJoCo.

MuJoCo is imported only when a sensor is made.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from os import PathLike
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._dermis import Calibration, Model, Skin
from .contacts import Carried, SimulatedSkin, SkinReading, SpatialTouches, carried, spatial
from .errors import FileError, InputError, SkinError

__all__ = ["Patch", "SkinSensor"]

_TIE_S = 1e-9
"""Tolerance for due frames, because sums of time steps are not exact."""

_MOST_MM = 1e5
"""Largest offset of a mount."""

_NONE = Carried(np.empty(0, np.intp), *(np.empty(0) for _ in range(4)))
"""No contacts."""


@dataclass(frozen=True)
class Patch:
    """A patch of skin on a geom or a body of a MuJoCo model.

    The patch's frame has x right, y up, z out of the skin, and its origin in the middle of the sheet; a bent skin
    curves away behind it.

    Parameters
    ----------
    name : str
        Name in readings.
    skin : Skin, Model or str
        The skin. Patches with one model share its mesh and operator.
    geom, body : str or int, optional
        The geom or the body that it covers, by name or number; exactly one of them. On a body, contacts of all its
        geoms count. The frame of a mesh geom is the one that MuJoCo has centred, not the file's.
    xyz_mm : tuple of float
        The patch's origin in the frame of the geom or body.
    rpy_deg : tuple of float
        Roll, pitch and yaw of the patch there, about the fixed axes x, y, z in this order, as in URDF.
    radius_mm : float, optional
        Radius of the disc pressed by each contact; default: the skin's usual press.
    reach_mm : float
        Largest distance between a contact and the skin's surface; contacts beyond it are on other parts of the geom.
    calibration, forces : str or os.PathLike, optional
        As for :class:`dermis.Pipeline`.
    """

    name: str
    skin: Skin | Model | str | PathLike[str]
    geom: str | int | None = None
    body: str | int | None = None
    xyz_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rpy_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    radius_mm: float | None = None
    reach_mm: float = 5.0
    calibration: Calibration | str | PathLike[str] | None = None
    forces: str | PathLike[str] | None = None


class _Mounted:
    """A patch on its geom or body, with its simulated skin."""

    def __init__(self, patch: Patch, model: Any, seed: int) -> None:
        if not (isinstance(patch.name, str) and patch.name):
            raise InputError(f"name = {patch.name!r}: expected a name for the patch")
        where = f"patch {patch.name!r}: "
        if (patch.geom is None) == (patch.body is None):
            got = "neither" if patch.geom is None else "both"
            raise InputError(f"{where}expected geom or body, got {got}")
        self.patch = patch
        self.of_body = patch.geom is None
        if self.of_body:
            self.number = _number(where, model, "body", patch.body)
            self.geoms = np.flatnonzero(model.geom_bodyid == self.number).tolist()
        else:
            self.number = _number(where, model, "geom", patch.geom)
            self.geoms = [self.number]
        if not self.geoms:
            raise InputError(f"{where}body = {patch.body!r}: expected a body with geoms, this one has none")
        self.origin_mm = _three(f"{where}xyz_mm", patch.xyz_mm)
        self.rotation = _rotation(np.deg2rad(_three(f"{where}rpy_deg", patch.rpy_deg)))
        try:
            self.simulated = SimulatedSkin(
                patch.skin,
                name=patch.name,
                seed=seed,
                radius_mm=patch.radius_mm,
                reach_mm=patch.reach_mm,
                calibration=patch.calibration,
                forces=patch.forces,
            )
        except (FileError, InputError, SkinError) as error:
            raise type(error)(f"{where}{error}") from error
        self.frames, self.due_s = 0, 0.0
        self.reading: SkinReading | None = None

    def mount_pose(self, data: Any) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Rotation and origin (millimetres) of the geom or body in the world."""
        turns, places = (data.xmat, data.xpos) if self.of_body else (data.geom_xmat, data.geom_xpos)
        turn = turns[self.number].reshape(3, 3)
        if not turn.any():
            raise InputError("data: expected positions of geoms; call mujoco.mj_forward first")
        return turn, 1e3 * places[self.number]

    def pose(self, data: Any) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Rotation and origin (millimetres) of the patch in the world."""
        turn, origin_mm = self.mount_pose(data)
        return turn @ self.rotation, turn @ self.origin_mm + origin_mm

    def in_patch(
        self, data: Any, positions_mm: NDArray[np.float64], forces_n: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Transforms positions and forces from the world to the patch's frame."""
        turn, origin_mm = self.pose(data)
        return (positions_mm - origin_mm) @ turn, forces_n @ turn


class SkinSensor:
    """Patches of skin on a MuJoCo model.

    Call :meth:`update` after each ``mj_step``. A patch makes frames at its skin's own rate, under the contacts of that
    moment, and keeps the last one in between.

    Parameters
    ----------
    model : mujoco.MjModel
        The model.
    data : mujoco.MjData
        Its state.
    patches : Patch or iterable of Patch
        The patches, with different names. A geom carries one patch; a body may carry several, and a contact counts for
        the nearest.
    seed : int
        Seed of the instruments' noise; each patch derives its own from it.

    Raises
    ------
    InputError
        An unknown geom or body, a name or a geom used twice, or a number out of range; the message names the patch and
        the field.
    ImportError
        MuJoCo is not installed.

    Examples
    --------
    >>> import mujoco
    >>> from dermis.mujoco import Patch, SkinSensor
    >>> model = mujoco.MjModel.from_xml_string('''<mujoco><worldbody>
    ...     <geom name="table" type="cylinder" size="0.1 0.01"/>
    ...     <body pos="0.02 0.03 0.03"><freejoint/><geom type="sphere" size="0.02" mass="0.04"/></body>
    ... </worldbody></mujoco>''')
    >>> data = mujoco.MjData(model)
    >>> palm = Patch("palm", "ionic-disc", geom="table", xyz_mm=(0, 0, 10))
    >>> sensor = SkinSensor(model, data, palm, seed=1)
    >>> for _ in range(500):
    ...     mujoco.mj_step(model, data)
    ...     readings = sensor.update()
    >>> print(sensor.touches("palm").position_mm.round(-1))
    [[20. 30. 10.]]
    """

    def __init__(self, model: Any, data: Any, patches: Patch | Iterable[Patch], *, seed: int = 0) -> None:
        import mujoco

        self._mujoco: Any = mujoco
        for name, value, kind in (("model", model, mujoco.MjModel), ("data", data, mujoco.MjData)):
            if not isinstance(value, kind):
                raise InputError(f"{name}: expected a mujoco.{kind.__name__}, got {type(value).__name__}")
        given = [patches] if isinstance(patches, Patch) else list(patches)
        if not given:
            raise InputError("patches: expected at least one, got none")
        for number, patch in enumerate(given):
            if not isinstance(patch, Patch):
                raise InputError(f"patches[{number}]: expected a dermis.mujoco.Patch, got {type(patch).__name__}")
        if not (isinstance(seed, (int, np.integer)) and not isinstance(seed, bool) and seed >= 0):
            raise InputError(f"seed = {seed!r}: expected a whole number, 0 or more")
        _check_unique(given, model)
        self._model, self._data = model, data
        self._begun_s, self._last_s = 0.0, 0.0
        self._mounted = {
            patch.name: _Mounted(patch, model, int(seed) + number) for number, patch in enumerate(given)
        }
        # Patches that cover each geom.
        self._covering: list[list[_Mounted]] = [[] for _ in range(model.ngeom)]
        for mounted in self._mounted.values():
            for geom in mounted.geoms:
                self._covering[geom].append(mounted)
        self._covered = np.array([bool(covering) for covering in self._covering] + [False])
        self._start()

    @property
    def patches(self) -> tuple[Patch, ...]:
        """The patches."""
        return tuple(mounted.patch for mounted in self._mounted.values())

    def skin(self, patch: str) -> Skin:
        """The skin of a patch."""
        return self._of(patch).simulated.skin

    def update(self) -> list[SkinReading]:
        """Makes the frames that have become due since the last call.

        If the simulation's time has gone back, as after ``mj_resetData``, the sensor is reset first.

        Returns
        -------
        list of SkinReading
            The new readings, oldest first for each patch; usually none or one.
        """
        now_s = float(self._data.time)
        if now_s < self._last_s:
            self.reset()
        self._last_s = now_s
        due = [mounted for mounted in self._mounted.values() if mounted.due_s <= now_s + _TIE_S]
        if not due:
            return []
        contacts = self._contacts()
        readings = []
        for mounted in due:
            while mounted.due_s <= now_s + _TIE_S:
                reading = mounted.simulated.press(contacts[mounted.patch.name], time_s=mounted.due_s)
                mounted.reading = reading
                mounted.frames += 1
                mounted.due_s = self._begun_s + mounted.frames * mounted.simulated.period_s
                readings.append(reading)
        return readings

    def reading(self, patch: str) -> SkinReading:
        """The last reading of a patch.

        Parameters
        ----------
        patch : str
            Name of the patch.

        Returns
        -------
        SkinReading
            Frame, result and true contacts.

        Raises
        ------
        InputError
            There is no such patch, or it has made no frame.
        """
        reading = self._of(patch).reading
        if reading is None:
            raise InputError(f"patch {patch!r}: no frame yet; expected a call of update() first")
        return reading

    def touches(self, patch: str, frame: Literal["patch", "mount", "world"] = "world") -> SpatialTouches:
        """The touches of a patch's last reading, in space.

        Parameters
        ----------
        patch : str
            Name of the patch.
        frame : str
            ``"patch"``, ``"mount"`` (the geom or body) or ``"world"``, at its current pose.

        Returns
        -------
        SpatialTouches
            Positions, normals, forces on the sensor, covariances.
        """
        mounted = self._of(patch)
        touches = spatial(mounted.simulated.skin, self.reading(patch).result.touches)
        if frame == "patch":
            return touches
        if frame == "mount":
            return touches.in_frame(mounted.rotation, mounted.origin_mm)
        if frame == "world":
            return touches.in_frame(*mounted.pose(self._data))
        raise InputError(f"frame = {frame!r}: expected 'patch', 'mount' or 'world'")

    def contacts(self, patch: str) -> Carried:
        """MuJoCo's current contacts on a patch, whether or not a frame is due: the ground truth.

        Parameters
        ----------
        patch : str
            Name of the patch.

        Returns
        -------
        Carried
            Positions on the sheet laid flat, and forces into the skin.
        """
        return self._contacts()[self._of(patch).patch.name]

    def pose(self, patch: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Pose of a patch in the world.

        Parameters
        ----------
        patch : str
            Name of the patch.

        Returns
        -------
        rotation : numpy.ndarray
            Shape (3, 3): from the patch's frame to the world's.
        origin_mm : numpy.ndarray
            Shape (3,): the patch's origin in the world.
        """
        return self._of(patch).pose(self._data)

    def reset(self) -> None:
        """Unloads all patches and learns their baselines again. The next frames are due at once."""
        for mounted in self._mounted.values():
            mounted.simulated.reset()
        self._start()

    def _start(self) -> None:
        self._begun_s = self._last_s = float(self._data.time)
        for mounted in self._mounted.values():
            mounted.due_s, mounted.frames, mounted.reading = self._begun_s, 0, None

    def _of(self, patch: str) -> _Mounted:
        mounted = self._mounted.get(patch)
        if mounted is None:
            raise InputError(f"patch = {patch!r}: expected one of {', '.join(map(repr, self._mounted))}")
        return mounted

    def _contacts(self) -> dict[str, Carried]:
        """The contacts on each patch. One that several patches could carry goes to the nearest."""
        contact = self._data.contact
        geoms = np.asarray(contact.geom).reshape(-1, 2)
        positions_mm = 1e3 * np.asarray(contact.pos).reshape(-1, 3)
        sides, forces = [], []
        wrench = np.zeros(6)
        for index in np.flatnonzero(self._covered[geoms].any(axis=1)):
            self._mujoco.mj_contactForce(self._model, self._data, int(index), wrench)
            # The rows of a contact's frame are its axes in the world; the force acts on the second geom.
            force = wrench[:3] @ np.asarray(contact.frame[index]).reshape(3, 3)
            for side, sign in ((0, -1.0), (1, 1.0)):
                if self._covered[geoms[index, side]]:
                    sides.append((index, geoms[index, side]))
                    forces.append(sign * force)
        if not sides:
            return dict.fromkeys(self._mounted, _NONE)
        places, loads = positions_mm[[index for index, _ in sides]], np.array(forces)
        found, nearest_mm = {}, np.full(len(sides), np.inf)
        for name, mounted in self._mounted.items():
            mine = np.array([n for n, (_, geom) in enumerate(sides) if mounted in self._covering[geom]], dtype=np.intp)
            local_mm, local_n = mounted.in_patch(self._data, places[mine], loads[mine])
            try:
                pressing = carried(mounted.simulated.skin, local_mm, local_n, reach_mm=mounted.patch.reach_mm)
            except InputError as error:
                raise InputError(f"patch {name!r}: MuJoCo's contacts: {error}") from error
            numbers = mine[pressing.index]
            nearest_mm[numbers] = np.minimum(nearest_mm[numbers], np.abs(pressing.height_mm))
            found[name] = (numbers, pressing)
        result = {}
        for name, (numbers, pressing) in found.items():
            kept = np.abs(pressing.height_mm) <= nearest_mm[numbers]
            result[name] = Carried(
                np.array([sides[n][0] for n in numbers[kept]], dtype=np.intp),
                *(column[kept] for column in (pressing.x_mm, pressing.y_mm, pressing.height_mm, pressing.force_n)),
            )
        return result


def _check_unique(patches: list[Patch], model: Any) -> None:
    names: set[str] = set()
    geoms: dict[int, str] = {}
    for patch in patches:
        if patch.name in names:
            raise InputError(f"name = {patch.name!r}: expected a different name for each patch, got it twice")
        names.add(patch.name)
        if patch.geom is not None:
            number = _number(f"patch {patch.name!r}: ", model, "geom", patch.geom)
            if number in geoms:
                other = geoms[number]
                expected = "expected one patch per geom; a body can carry several"
                raise InputError(f"patch {patch.name!r}: geom = {patch.geom!r} already has patch {other!r}: {expected}")
            geoms[number] = patch.name


def _number(where: str, model: Any, kind: str, value: str | int | None) -> int:
    """The number of a geom or body, from its name or number."""
    count = model.ngeom if kind == "geom" else model.nbody
    if isinstance(value, (int, np.integer)) and not isinstance(value, bool):
        if 0 <= value < count:
            return int(value)
        raise InputError(f"{where}{kind} = {value}: expected 0 to {count - 1}")
    if not isinstance(value, str):
        raise InputError(f"{where}{kind} = {value!r}: expected the name or number of a {kind}")
    of = model.geom if kind == "geom" else model.body
    names = [of(number).name for number in range(count)]
    if value in names and value:
        return names.index(value)
    known = ", ".join(repr(name) for name in names if name) or "none with a name: give its number"
    raise InputError(f"{where}{kind} = {value!r}: expected a {kind} of the model ({known})")


def _three(name: str, values: ArrayLike) -> NDArray[np.float64]:
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        array = np.empty(0)
    if array.shape != (3,) or not np.isfinite(array).all() or np.abs(array).max() > _MOST_MM:
        raise InputError(f"{name} = {values!r}: expected three finite numbers, at most {_MOST_MM:g}")
    return array


def _rotation(rpy_rad: NDArray[np.float64]) -> NDArray[np.float64]:
    """R_z(yaw) R_y(pitch) R_x(roll)."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(rpy_rad), np.sin(rpy_rad)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )
