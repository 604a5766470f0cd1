"""Train the crack network on labelled cells and write it as an ONNX file.

    python -m pv_inspect.cracks.training.train CELLS OUT [--split modules] [--sharp]

By default train/ and val/ are as given; ``--split modules`` leaves no module in both parts,
``--sharp`` leaves the degradation of the cells out.

CELLS holds train/ and val/, each with img/ and ann/ (see
`pv_inspect.cracks.training.labelled`). OUT gets network.onnx with its description network.json,
state.pt and log.csv. Needs
``pip install "pv-inspect[train]"``; inference does not.

The network is a U-Net with additive skips [1]_ at half the resolution of its input: cracks are
found by context, and the four sub-pixels of a position are one convolution of the last features.

References
----------
.. [1] O. Ronneberger, P. Fischer, T. Brox, "U-Net: Convolutional Networks for Biomedical Image
       Segmentation", MICCAI 2015. doi:10.1007/978-3-319-24574-4_28
"""

from __future__ import annotations

import argparse
import csv
import hashlib
import json
import sys
import warnings
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn
from torch.nn import functional

from pv_inspect.cracks.classes import CLASSES, CRACK
from pv_inspect.cracks.network import CELL_PX, NetworkDetector, normalised
from pv_inspect.cracks.training.augmentation import Augmentation, prepared
from pv_inspect.cracks.training.labelled import LabelledCell, read_labelled, split_modules
from pv_inspect.cracks.training.labelled_maps import as_they_are, degraded, operating_point
from pv_inspect.cracks.training.reliability import fit_calibration
from pv_inspect.cracks.training.scores import pixel_score

__all__ = ["CRACKED_PX", "CrackNet", "Recipe", "describe", "probabilities", "train", "write_onnx"]

_CHANNELS = (16, 32, 64, 96)
# Weights of the cross entropy, in the order of CLASSES: rare classes count more.
_CLASS_WEIGHTS = (1.0, 2.0, 6.0, 4.0, 1.0)
# A cell with fewer crack pixels counts as one without.
CRACKED_PX = 40


@dataclass(frozen=True)
class Recipe:
    """How the network is trained.

    Parameters
    ----------
    steps : int
        Batches; the learning rate falls to 0 over them as a cosine.
    batch : int
        Cells per batch.
    learning_rate, weight_decay : float
        Of AdamW.
    averaging : float
        Weight of the past in the moving average of the weights, per step.
    cracked_share : float
        Share of the drawn cells that have cracks.
    half_cut_share : float
        Share of the batches that are cut into halves of cells.
    degrade : bool
        See `Augmentation`.
    seed : int
    """

    steps: int = 6000
    batch: int = 8
    learning_rate: float = 3e-3
    weight_decay: float = 1e-3
    averaging: float = 0.995
    cracked_share: float = 0.55
    half_cut_share: float = 0.2
    degrade: bool = True
    seed: int = 0


def convolution(inputs: int, outputs: int, stride: int = 1, size: int = 3) -> nn.Sequential:
    """Convolution without bias, batch normalisation, ReLU."""
    return nn.Sequential(
        nn.Conv2d(inputs, outputs, size, stride, size // 2, bias=False),
        nn.BatchNorm2d(outputs),
        nn.ReLU(inplace=True),
    )


class CrackNet(nn.Module):
    """Fully convolutional segmenter; input sizes are multiples of 16.

    Maps (n, 1, h, w) to logits (n, 5, h, w), one channel for each of `CLASSES`.
    """

    def __init__(self) -> None:
        super().__init__()
        c = _CHANNELS
        self.stem = nn.Sequential(convolution(1, c[0], 2, 5), convolution(c[0], c[0]))
        self.down = nn.ModuleList(
            nn.Sequential(convolution(c[i], c[i + 1], 2), convolution(c[i + 1], c[i + 1]))
            for i in range(3)
        )
        self.narrow = nn.ModuleList(nn.Conv2d(c[i + 1], c[i], 1) for i in range(3))
        self.up = nn.ModuleList(convolution(c[i], c[i]) for i in range(3))
        self.head = nn.Conv2d(c[0], 4 * len(CLASSES), 1)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Return the logits."""
        features = [self.stem(x)]
        for down in self.down:
            features.append(down(features[-1]))
        y = features.pop()
        for narrow, up in zip(reversed(self.narrow), reversed(self.up), strict=True):
            y = functional.interpolate(narrow(y), scale_factor=2.0, mode="nearest")
            y = up(y + features.pop())
        return functional.pixel_shuffle(self.head(y), 2)


class _WithSoftmax(nn.Module):
    def __init__(self, net: nn.Module) -> None:
        super().__init__()
        self.net = net

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return torch.softmax(self.net(x), 1)


def loss_of(logits: torch.Tensor, label: torch.Tensor) -> torch.Tensor:
    """Weighted cross entropy plus 1 - Dice of the cracks over the whole batch."""
    entropy = functional.cross_entropy(logits, label, torch.tensor(_CLASS_WEIGHTS))
    p, t = torch.softmax(logits, 1)[:, CRACK], (label == CRACK).float()
    dice = (2 * (p * t).sum() + 1) / (p.sum() + t.sum() + 1)
    return entropy + 1 - dice


def batches(
    cells: list[LabelledCell], recipe: Recipe
) -> Iterator[tuple[torch.Tensor, torch.Tensor]]:
    """Draw batches without end: inputs (n, 1, h, w) and labels (n, h, w)."""
    rng = np.random.default_rng(recipe.seed)
    augment = Augmentation(recipe.degrade)
    small = [prepared(cell.image, cell.label) for cell in cells]
    cracked = np.array([int(cell.crack.sum()) >= CRACKED_PX for cell in cells])
    pools = [np.flatnonzero(cracked), np.flatnonzero(~cracked)]
    while True:
        halves = recipe.degrade and rng.random() < recipe.half_cut_share
        upright = rng.random() < 0.5
        inputs, labels = [], []
        for _ in range(recipe.batch * (2 if halves else 1)):
            pool = pools[0] if rng.random() < recipe.cracked_share else pools[1]
            image, label = small[int(rng.choice(pool))]
            if halves:
                image, label = _half(image, label, rng)
            seen, classes = augment(image, label, rng)
            if halves and (seen.shape[0] > seen.shape[1]) != upright:
                seen, classes = np.rot90(seen), np.rot90(classes)
            inputs.append(np.ascontiguousarray(seen))
            labels.append(np.ascontiguousarray(classes))
        yield (
            torch.from_numpy(np.stack(inputs)[:, None]),
            torch.from_numpy(np.stack(labels).astype(np.int64)),
        )


def _half(
    image: NDArray[np.uint8], label: NDArray[np.uint8], rng: np.random.Generator
) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """One half of a cell, cut along or across the busbars."""
    if rng.random() < 0.5:
        image, label = image.T, label.T
    n = image.shape[0] // 2
    start = int(rng.integers(2)) * n
    return (
        np.ascontiguousarray(image[start : start + n]),
        np.ascontiguousarray(label[start : start + n]),
    )


@torch.no_grad()
def probabilities(net: nn.Module, cells: list[LabelledCell]) -> list[NDArray[np.float32]]:
    """Crack probability of every pixel of cells, at the size of their images."""
    net.eval()
    maps = []
    for cell in cells:
        image, _ = prepared(cell.image, cell.label)
        x = torch.from_numpy(normalised(np.asarray(image, np.float32)))[None, None]
        p = torch.softmax(net(x), 1)[0, CRACK].numpy()
        maps.append(np.asarray(cv2.resize(p, cell.image.shape[::-1]), np.float32))
    return maps


def train(
    cells: list[LabelledCell],
    judged: list[LabelledCell],
    out: Path,
    recipe: Recipe,
    judge_every: int = 600,
) -> CrackNet:
    """Train a network.

    Parameters
    ----------
    cells, judged : list of LabelledCell
        To learn from, and to write figures about into the log.
    out : Path
        Folder for log.csv and state.pt.
    recipe : Recipe
    judge_every : int
        Steps from one line of the log to the next.

    Returns
    -------
    CrackNet
        With the averaged weights.
    """
    torch.manual_seed(recipe.seed)
    net, averaged = (CrackNet().to(memory_format=torch.channels_last) for _ in range(2))
    averaged.load_state_dict(net.state_dict())
    optimiser = torch.optim.AdamW(
        net.parameters(), recipe.learning_rate, weight_decay=recipe.weight_decay
    )
    warm_up = max(recipe.steps // 20, 1)
    out.mkdir(parents=True, exist_ok=True)
    log, total, begun = [], 0.0, (perf_counter(), process_time())
    for step, (inputs, labels) in zip(
        range(1, recipe.steps + 1), batches(cells, recipe), strict=False
    ):
        share = (step - 1) / recipe.steps
        rate = recipe.learning_rate * min(step / warm_up, 1.0) * 0.5 * (1 + np.cos(np.pi * share))
        for group in optimiser.param_groups:
            group["lr"] = rate
        net.train()
        optimiser.zero_grad()
        loss = loss_of(net(inputs), labels)
        loss.backward()
        optimiser.step()
        _average(averaged, net, min(recipe.averaging, (1 + step) / (10 + step)))
        total += float(loss.detach())
        if step % judge_every == 0 or step == recipe.steps:
            maps = probabilities(averaged, judged)
            score = pixel_score((p, c.crack) for p, c in zip(maps, judged, strict=True))
            log.append(
                {
                    "step": step,
                    "loss": round(total / ((step - 1) % judge_every + 1), 4),
                    "crack_ap": round(score.ap, 4),
                    "crack_f1": round(score.f1, 4),
                    "level": round(score.level, 3),
                    "cpu_s": round(process_time() - begun[1]),
                    "wall_s": round(perf_counter() - begun[0]),
                }
            )
            total = 0.0
            with (out / "log.csv").open("w", newline="", encoding="utf-8") as file:
                writer = csv.DictWriter(file, list(log[0]))
                writer.writeheader()
                writer.writerows(log)
            torch.save(averaged.state_dict(), out / "state.pt")
    return averaged


@torch.no_grad()
def _average(averaged: nn.Module, net: nn.Module, past: float) -> None:
    now = net.state_dict()
    for name, value in averaged.state_dict().items():
        if value.dtype.is_floating_point:
            value.mul_(past).add_(now[name], alpha=1 - past)
        else:
            value.copy_(now[name])


def write_onnx(net: nn.Module, path: Path) -> None:
    """Write a network with its softmax; number and size of the cells are free."""
    export(_WithSoftmax(net), path)


def export(net: nn.Module, path: Path) -> None:
    """Write a network that maps cells to probabilities."""
    with warnings.catch_warnings():
        # The exporter that is meant to replace this one needs two more packages.
        warnings.simplefilter("ignore", DeprecationWarning)
        torch.onnx.export(
            net.eval(),
            (torch.zeros(1, 1, CELL_PX, CELL_PX),),
            str(path),
            input_names=["cells"],
            output_names=["probabilities"],
            dynamic_axes={
                "cells": {0: "n", 2: "h", 3: "w"},
                "probabilities": {0: "n", 2: "h", 3: "w"},
            },
            opset_version=17,
            dynamo=False,
        )


def describe(network: Path, name: str, judged: list[LabelledCell], seed: int = 0) -> None:
    """Calibrate a network, choose its operating point, and write the description beside it.

    Half of the pixels that the calibration is fitted to are of cells as they are, half of cells
    as `Augmentation` degrades them: super-resolved tiles lie in between.

    Parameters
    ----------
    network : Path
        ONNX file.
    name : str
        For reports: the network, and what it was trained on.
    judged : list of LabelledCell
        Cells that the network has not learnt from.
    seed : int
        For the degradation.
    """
    about: dict[str, Any] = {
        "name": name,
        "sha256": hashlib.sha256(network.read_bytes()).hexdigest(),
        "classes": CLASSES,
        "calibration": {"slope": 1.0, "offset": 0.0},
        "operating_point": {"threshold": 0.5, "least_extent_cells": 0.05},
    }
    path = network.with_suffix(".json")
    path.write_text(json.dumps(about, indent=1) + "\n", encoding="utf-8")
    detector = NetworkDetector(network)
    pairs = [*as_they_are(detector, judged), *degraded(detector, judged, seed)]
    slope, offset = fit_calibration(pairs)
    about["calibration"] = {"slope": round(slope, 5), "offset": round(offset, 5)}
    path.write_text(json.dumps(about, indent=1) + "\n", encoding="utf-8")
    maps = list(as_they_are(NetworkDetector(network), judged))
    point = operating_point(maps)
    about["operating_point"] = asdict(point)
    path.write_text(json.dumps(about, indent=1) + "\n", encoding="utf-8")


def main() -> None:
    """Train as the command line says."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("cells", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--split", choices=("given", "modules"), default="given")
    parser.add_argument("--sharp", action="store_true", help="no degradation of the cells")
    parser.add_argument("--steps", type=int, default=Recipe.steps)
    parser.add_argument("--seed", type=int, default=Recipe.seed)
    parser.add_argument("--name", default="network trained on own cells", help="for reports")
    parser.add_argument("--threads", type=int, default=2)
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    cells = read_labelled(options.cells / "train")
    judged = read_labelled(options.cells / "val")
    if options.split == "modules":
        cells, judged = split_modules([*cells, *judged])
    sys.stderr.write(f"{len(cells)} cells to learn from, {len(judged)} to judge with\n")
    recipe = Recipe(steps=options.steps, degrade=not options.sharp, seed=options.seed)
    net = train(cells, judged, options.out, recipe)
    write_onnx(net, options.out / "network.onnx")
    kind = "sharp cells only" if options.sharp else "degraded cells"
    describe(options.out / "network.onnx", f"{options.name}, {kind}", judged)


if __name__ == "__main__":
    main()
