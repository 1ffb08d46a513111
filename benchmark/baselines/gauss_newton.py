"""One-step Gauss-Newton: a smooth forward model, one linear step, and the covariance of that step as sigma.

With labels, the forward model is learnt: kernel ridge regression gives frames as a function of place, and the step starts
at the best point of a grid; each of several points adds its own response. Without labels, the model is a disc's closed form.
"""

import numpy as np

from .gauss_newton_image import segment, unlabelled  # noqa: F401  The tasks without labels.

GRID = 21


class Map:
    """Frames as a smooth function of the target, s(x) = k(x, X) A, with the variance of each channel about it."""

    def __init__(self, targets, frames):
        self.targets, self.middle = targets, frames.mean(0)
        gaps = ((targets[:, None] - targets[None]) ** 2).sum(2)
        best = (np.inf, None, None, None)
        for length in np.sqrt(gaps[:400, :400].max()) * np.array([0.1, 0.2, 0.4]):
            for ridge in (1e-3, 1e-2, 1e-1):
                inverse = np.linalg.inv(np.exp(-gaps[:400, :400] / (2 * length**2)) + ridge * np.eye(min(400, len(gaps))))
                errors = inverse @ (frames[:400] - self.middle) / np.diag(inverse)[:, None]
                best = min(best, ((errors**2).sum(), length, ridge, (errors**2).mean(0)), key=lambda found: found[0])
        _, self.length, ridge, variances = best
        self.weights = 1 / (variances + 0.01 * variances.mean() + 1e-12)
        self.amplitudes = np.linalg.solve(np.exp(-gaps / (2 * self.length**2)) + ridge * np.eye(len(gaps)), frames - self.middle)
        low, high = targets.min(0), targets.max(0)
        self.starts = np.stack(np.meshgrid(*np.linspace(low, high, GRID).T), -1).reshape(-1, targets.shape[1])
        self.expected, self.slopes = self.frames(self.starts)
        spread = np.einsum("kdc,c,kec->kde", self.slopes, self.weights, self.slopes, optimize=True)
        self.covariance = np.linalg.inv(spread + np.diag(1 / ((high - low) / (GRID - 1) + 1e-9) ** 2))

    def frames(self, points):
        """Expected frames and their derivatives: points x channels, points x targets x channels."""
        away = points[:, None] - self.targets[None]
        kernel = np.exp(-(away**2).sum(2) / (2 * self.length**2))
        slopes = -(away * kernel[..., None]).transpose(0, 2, 1) / self.length**2
        return self.middle + kernel @ self.amplitudes, slopes @ self.amplitudes

    def step(self, frames):
        weighted = self.expected * self.weights
        start = ((weighted * self.expected).sum(1)[None] - 2 * frames @ weighted.T).argmin(1)
        residuals, covariance = (frames - self.expected[start]) * self.weights, self.covariance[start]
        pull = np.einsum("kdc,kc->kd", self.slopes[start], residuals)
        found = self.starts[start] + np.einsum("kde,ke->kd", covariance, pull)
        return found, np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))


def regress(told):
    if told.kind != "place":  # Depth changes a frame less than place does, so without a model of both there is no step.
        return superposed(told) if told.kind == "points" else None
    scale = told.frames.std(0) + 1e-12

    def features(frames):
        return frames / scale / (np.linalg.norm(frames / scale, axis=1, keepdims=True) + 1e-12)

    known, fold, ratios = features(told.frames), np.arange(len(told.frames)) % 5, []
    for left_out in range(5 if len(known) < 100 else 1):  # Rescales sigma, as the step assumes independent channels.
        found, sigma = Map(told.targets[fold != left_out], known[fold != left_out]).step(known[fold == left_out])
        ratios.append((found - told.targets[fold == left_out]) / sigma)
    boldness, model = np.sqrt((np.concatenate(ratios) ** 2).mean(0)), Map(told.targets, known)

    def answer(frames):
        found, sigma = model.step(features(frames))
        return found, sigma * boldness

    return answer


def superposed(told):
    """Each point adds its own response. The step solves for the amplitudes, each with a prior of one."""
    count, ridge = told.targets.shape[1], 1.0
    responses = np.linalg.solve(told.targets.T @ told.targets + ridge * np.eye(count), told.targets.T @ told.frames)
    weights = 1 / ((told.frames - told.targets @ responses).var(0) + 1e-12)
    solve = np.linalg.solve((responses * weights) @ responses.T + np.eye(count), responses * weights)
    return lambda frames: (frames @ solve.T, np.full((len(frames), count), 0.5))
