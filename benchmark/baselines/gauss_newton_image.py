"""One-step Gauss-Newton images of a disc, without labels: presses on the gel disc, and label images of the tank.

The step is x = C J' (J C J' + L)^-1 y, with closed-form sensitivities J from `disc.py`, a smooth prior C and noise L.
"""

import numpy as np

from . import disc


def step(jacobian, points, length, noise):
    """Matrix from whitened data to conductivity. Covariance exp(-d / length); noise relative to the mean of the data."""
    covariance = np.exp(-np.hypot(*(points[:, None] - points[None]).transpose(2, 0, 1)) / length)
    spread = jacobian @ covariance
    data = spread @ jacobian.T
    return np.linalg.solve(data + noise * np.trace(data) / len(data) * np.eye(len(data)), spread).T


def unlabelled(told):
    """Relative changes, with each channel divided by its noise at rest. The touch is where conductivity drops most."""
    electrodes = told.electrodes_m / told.radius_m
    points, _ = disc.grid(41)
    model = disc.voltages(electrodes, told.drives, told.reads)
    noise = np.diff(told.rest, axis=0).std(0) / told.rest.mean(0) + 1e-9
    jacobian = disc.sensitivities(points, electrodes, told.drives, told.reads) / (model * noise)[:, None]
    jacobian *= (np.abs(model) > 0.02 * np.abs(model).max())[:, None]
    solve = step(jacobian, points, 0.2, 1.0)

    def answer(frames, rest):
        images = ((frames - rest) / rest / noise) @ solve.T
        lowered = np.maximum(-images, 0)
        peak = lowered.argmax(1)
        near = ((points[None] - points[peak][:, None]) ** 2).sum(2) < 0.3**2
        blob = np.where(near & (lowered > 0.5 * lowered.max(1, keepdims=True)), lowered, 0) + 1e-12 * near
        share = blob / blob.sum(1, keepdims=True)
        middle = share @ points
        spread = np.sqrt(np.maximum(share @ points**2 - middle**2, 1e-4))
        return middle * told.radius_m, spread * told.radius_m

    return answer


def otsu(values, bins=64):
    """Two thresholds that split values into three classes with the least variance within classes (Otsu 1979)."""
    edges = np.linspace(values.min(), values.max() + 1e-12, bins + 1)
    counts, centres = np.histogram(values, edges)[0].astype(float), (edges[1:] + edges[:-1]) / 2
    mass, moment = np.append(0, np.cumsum(counts)), np.append(0, np.cumsum(counts * centres))
    best = (-1, 0, 0)
    for first in range(1, bins - 1):
        for second in range(first + 1, bins):
            cuts = [0, first, second, bins]
            masses, moments = np.diff(mass[cuts]), np.diff(moment[cuts])
            between = (moments**2 / np.maximum(masses, 1e-12)).sum()
            best = max(best, (between, edges[first], edges[second]))
    return best[1:]


def segment(told):
    """Images the voltage change relative to the reference and splits it by Otsu. The largest class is background."""
    side = 40
    points, inside = disc.grid(side)
    model = disc.voltages(told.electrodes, told.drives, told.reads)
    gain = (model @ told.reference) / (model @ model)
    weights = 1 / (np.abs(told.reference) + np.median(np.abs(told.reference)))
    jacobian = gain * disc.sensitivities(points, told.electrodes, told.drives, told.reads) * weights[:, None]
    solve = step(jacobian, points, 0.3, 0.01)

    def labels(frame):
        image = np.zeros(side * side)
        image[inside] = solve @ ((frame - told.reference) * weights)
        low, high = otsu(image[inside])
        classes = np.digitize(image, [low, high])
        background = np.bincount(classes[inside], minlength=3).argmax()
        found = np.where(classes == background, 0, np.where(classes < background, 1, 2))
        found[np.setdiff1d(np.arange(side * side), inside)] = 0
        scale = np.arange(256) * side // 256
        return found.reshape(side, side)[np.ix_(scale, scale)].astype(np.uint8)

    return lambda frames: np.array([labels(frame) for frame in frames])
