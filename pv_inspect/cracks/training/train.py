"""Train the crack network on labelled cells and write it as an ONNX file.

    python -m pv_inspect.cracks.training.train CELLS OUT [--split modules] [--sharp]

By default train/ and val/ are as given; ``--split modules`` leaves no module in both parts,
``--sharp`` leaves the degradation of the cells out, ``--own-metal`` the cells of other makers.

On a machine with a GPU, in minutes, and then what needs none, wherever this is installed::

    python -m pv_inspect.cracks.training.train CELLS OUT --weights-only --device cuda
        --processes 14 --batch 16 --steps 1000000 --minutes 6.5 --judge-every 6000
    python -m pv_inspect.cracks.training.train CELLS OUT --from-state OUT/state.pt --name NAME

The second line exports network.onnx, calibrates it, chooses the operating point and the evidence
that a class needs, measures the looks that were learnt, and writes all that beside it.
``python benchmarks/crack_looks.py CELLS --models default OUT/network.onnx`` compares cells of other
makers, ``python benchmarks/cracks.py cells CELLS --elpv ELPV --model OUT/network.onnx`` the others.
`pv_inspect.cracks.training.ensemble` joins several. To make one the default, copy both files to
``pv_inspect/cracks/models/default.*`` and put the SHA-256 into ``pv_inspect/cracks/network.py``.

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
from dataclasses import asdict
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
from pv_inspect.cracks.looks import KnownLooks
from pv_inspect.cracks.network import CELL_PX, NetworkDetector, normalised
from pv_inspect.cracks.training.augmentation import prepared
from pv_inspect.cracks.training.feeding import Recipe, many_batches
from pv_inspect.cracks.training.known_looks import known_looks, stored_looks
from pv_inspect.cracks.training.labelled import LabelledCell, read_labelled, split_modules
from pv_inspect.cracks.training.labelled_maps import (
    as_they_are,
    degraded,
    evidence,
    operating_point,
)
from pv_inspect.cracks.training.reliability import fit_calibration
from pv_inspect.cracks.training.scores import pixel_score

__all__ = ["CrackNet", "describe", "probabilities", "train", "write_onnx"]

_CHANNELS = (16, 32, 64, 96)
# Weights of the cross entropy, in the order of CLASSES: rare classes count more.
_CLASS_WEIGHTS = (1.0, 2.0, 6.0, 4.0, 1.0)


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
    entropy = functional.cross_entropy(
        logits, label, torch.tensor(_CLASS_WEIGHTS, device=logits.device)
    )
    p, t = torch.softmax(logits, 1)[:, CRACK], (label == CRACK).float()
    dice = (2 * (p * t).sum() + 1) / (p.sum() + t.sum() + 1)
    return entropy + 1 - dice


@torch.no_grad()
def probabilities(net: nn.Module, cells: list[LabelledCell]) -> list[NDArray[np.float32]]:
    """Crack probability of every pixel of cells, at the size of their images."""
    net.eval()
    device = next(net.parameters()).device
    maps = []
    for cell in cells:
        image, _ = prepared(cell.image, cell.label)
        x = torch.from_numpy(normalised(np.asarray(image, np.float32)))[None, None].to(device)
        p = torch.softmax(net(x), 1)[0, CRACK].cpu().numpy()
        maps.append(np.asarray(cv2.resize(p, cell.image.shape[::-1]), np.float32))
    return maps


def train(
    cells: list[LabelledCell],
    judged: list[LabelledCell],
    out: Path,
    recipe: Recipe,
    judge_every: int = 600,
    *,
    device: str = "cpu",
    processes: int = 0,
    minutes: float | None = None,
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
    device : str
        As torch names it.
    processes : int
        That draw the batches; 0 to draw them in this one.
    minutes : float, optional
        The training ends when this time is over, if that is before the last step; the learning
        rate follows the time. Not reproducible.

    Returns
    -------
    CrackNet
        With the averaged weights, on the CPU.
    """
    torch.manual_seed(recipe.seed)
    net, averaged = (CrackNet().to(device, memory_format=torch.channels_last) for _ in range(2))
    averaged.load_state_dict(net.state_dict())
    optimiser = torch.optim.AdamW(
        net.parameters(), recipe.learning_rate, weight_decay=recipe.weight_decay
    )
    warm_up = max(recipe.steps // 20, 1) if minutes is None else 500
    out.mkdir(parents=True, exist_ok=True)
    log: list[dict[str, float]] = []
    total, counted, begun = torch.zeros((), device=device), 0, (perf_counter(), process_time())
    with many_batches(cells, recipe, processes) as drawn:
        for step, (inputs, labels) in zip(range(1, recipe.steps + 1), drawn, strict=False):
            past = 0.0 if minutes is None else (perf_counter() - begun[0]) / (60 * minutes)
            share = min(max((step - 1) / recipe.steps, past), 1.0)
            last = step == recipe.steps or past >= 1
            rate = (
                recipe.learning_rate * min(step / warm_up, 1.0) * 0.5 * (1 + np.cos(np.pi * share))
            )
            for group in optimiser.param_groups:
                group["lr"] = rate
            net.train()
            optimiser.zero_grad()
            x = torch.from_numpy(inputs).to(device, non_blocking=True)
            loss = loss_of(net(x), torch.from_numpy(labels).to(device, non_blocking=True).long())
            loss.backward()
            optimiser.step()
            _average(averaged, net, min(recipe.averaging, (1 + step) / (10 + step)))
            total += loss.detach()
            counted += 1
            if step % judge_every == 0 or last:
                figures = {"step": step, "loss": round(float(total) / counted, 4)}
                if judged:
                    maps = probabilities(averaged, judged)
                    score = pixel_score((p, c.crack) for p, c in zip(maps, judged, strict=True))
                    figures |= {
                        "crack_ap": round(score.ap, 4),
                        "crack_f1": round(score.f1, 4),
                        "level": round(score.level, 3),
                    }
                figures["cpu_s"] = round(process_time() - begun[1])
                figures["wall_s"] = round(perf_counter() - begun[0])
                log.append(figures)
                total, counted = torch.zeros((), device=device), 0
                _write_log(out / "log.csv", log)
                torch.save(averaged.state_dict(), out / "state.pt")
            if last:
                break
    return averaged.to("cpu")


def _write_log(path: Path, log: list[dict[str, float]]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(log[0]))
        writer.writeheader()
        writer.writerows(log)


@torch.no_grad()
def _average(averaged: nn.Module, net: nn.Module, past: float) -> None:
    now = net.state_dict()
    values = averaged.state_dict()
    real = [name for name, value in values.items() if value.dtype.is_floating_point]
    torch._foreach_lerp_([values[n] for n in real], [now[n] for n in real], 1 - past)  # at once
    for name in values.keys() - set(real):
        values[name].copy_(now[name])


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


def describe(
    network: Path,
    name: str,
    judged: list[LabelledCell],
    seed: int = 0,
    looks: KnownLooks | None = None,
) -> None:
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
    looks : KnownLooks, optional
        Of the cells that it has learnt from.
    """
    about: dict[str, Any] = {
        "name": name,
        "sha256": hashlib.sha256(network.read_bytes()).hexdigest(),
        "classes": CLASSES,
        "calibration": {"slope": 1.0, "offset": 0.0},
        "operating_point": {"threshold": 0.5, "least_extent_cells": 0.05},
    }
    if looks is not None:
        about["looks"] = stored_looks(looks)
    path = network.with_suffix(".json")
    path.write_text(json.dumps(about, indent=1) + "\n", encoding="utf-8")
    detector = NetworkDetector(network)
    pairs = [*as_they_are(detector, judged), *degraded(detector, judged, seed)]
    slope, offset = fit_calibration(pairs)
    about["calibration"] = {"slope": round(slope, 5), "offset": round(offset, 5)}
    path.write_text(json.dumps(about, indent=1) + "\n", encoding="utf-8")
    maps = list(as_they_are(NetworkDetector(network), judged))
    point = evidence(maps, operating_point(maps))
    about["operating_point"] = asdict(point)
    path.write_text(json.dumps(about, indent=1) + "\n", encoding="utf-8")


def main() -> None:
    """Train as the command line says."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("cells", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--split", choices=("given", "modules"), default="given")
    parser.add_argument("--sharp", action="store_true", help="no degradation of the cells")
    parser.add_argument("--own-metal", action="store_true", help="no cells of other makers")
    parser.add_argument("--steps", type=int, default=Recipe.steps)
    parser.add_argument("--batch", type=int, default=Recipe.batch)
    parser.add_argument("--seed", type=int, default=Recipe.seed)
    parser.add_argument("--name", default="network trained on own cells", help="for reports")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--device", default="cpu", help="as torch names it, cuda for instance")
    parser.add_argument("--processes", type=int, default=0, help="that draw the batches")
    parser.add_argument("--minutes", type=float, help="end the training after this time")
    parser.add_argument("--judge-every", type=int, default=600, metavar="STEPS")
    part = parser.add_mutually_exclusive_group()
    part.add_argument("--weights-only", action="store_true", help="write state.pt and log.csv only")
    part.add_argument("--from-state", type=Path, help="do not train: export and describe these")
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    torch.backends.cudnn.benchmark = True
    cells = read_labelled(options.cells / "train")
    judged = read_labelled(options.cells / "val")
    if options.split == "modules":
        cells, judged = split_modules([*cells, *judged])
    sys.stderr.write(f"{len(cells)} cells to learn from, {len(judged)} to judge with\n")
    recipe = Recipe(
        steps=options.steps,
        batch=options.batch,
        degrade=not options.sharp,
        diverse=not (options.sharp or options.own_metal),
        seed=options.seed,
    )
    if options.from_state:
        net = CrackNet()
        net.load_state_dict(torch.load(options.from_state, map_location="cpu", weights_only=True))
        options.out.mkdir(parents=True, exist_ok=True)
    else:
        net = train(
            cells,
            judged,
            options.out,
            recipe,
            options.judge_every,
            device=options.device,
            processes=options.processes,
            minutes=options.minutes,
        )
    if options.weights_only:
        return
    write_onnx(net, options.out / "network.onnx")
    kind = "degraded cells of several kinds" if recipe.diverse else "degraded cells"
    kind = kind if recipe.degrade else "sharp cells only"
    looks = known_looks(cells, judged, recipe)
    describe(options.out / "network.onnx", f"{options.name}, {kind}", judged, looks=looks)


if __name__ == "__main__":
    main()
