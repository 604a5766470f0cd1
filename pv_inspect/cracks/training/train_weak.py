"""Train a crack network from cell labels alone, as the paper's comparison does.

    python -m pv_inspect.cracks.training.train_weak CELLS OUT

The network is only told whether a cell has a crack. Its activation map, one value per 16 x 16 px of
a cell of 256 px, is pooled by a normalised Lp norm [1]_ to one number for the cell; where the map
is high is then where the crack must be. OUT gets network.onnx with its description: it has the
same inputs and outputs as the other models, so that `NetworkDetector` runs it.

References
----------
.. [1] M. Mayr, M. Hoffmann, A. Maier, V. Christlein, "Weakly Supervised Segmentation of Cracks on
       Solar Cells using Normalized Lp Norm", ICIP 2019. arXiv:2001.11248
"""

from __future__ import annotations

import argparse
import csv
import hashlib
import json
import sys
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from time import process_time

import numpy as np
import torch
from torch import nn
from torch.nn import functional

from pv_inspect.cracks.classes import CLASSES, CRACK
from pv_inspect.cracks.network import NetworkDetector, normalised
from pv_inspect.cracks.training.augmentation import Augmentation, prepared
from pv_inspect.cracks.training.feeding import CRACKED_PX
from pv_inspect.cracks.training.labelled import LabelledCell, read_labelled
from pv_inspect.cracks.training.labelled_maps import as_they_are
from pv_inspect.cracks.training.scores import coarse_score, roc_auc
from pv_inspect.cracks.training.train import convolution, export

__all__ = ["WeakNet", "train_weak"]

_POWER = 6.0
_STRIDE = 16


class WeakNet(nn.Module):
    """Activation map of cracks at a sixteenth of the resolution, and its pooled value."""

    def __init__(self) -> None:
        super().__init__()
        widths = (16, 32, 64, 96)
        layers: list[nn.Module] = [convolution(1, widths[0], 2, 5)]
        for narrow, wide in pairwise(widths):
            layers += [convolution(narrow, wide, 2), convolution(wide, wide)]
        self.features = nn.Sequential(*layers)
        self.head = nn.Conv2d(widths[-1], 1, 1)
        self.offset = nn.Parameter(torch.tensor(-2.0))

    def activation(self, x: torch.Tensor) -> torch.Tensor:
        """Map (n, 1, h, w) to activations (n, 1, h / 16, w / 16), none negative."""
        return functional.softplus(self.head(self.features(x)))

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Log odds (n,) that the cell has a crack."""
        pooled = self.activation(x).pow(_POWER).mean((1, 2, 3)).clamp_min(1e-12) ** (1 / _POWER)
        return pooled + self.offset


class _AsClasses(nn.Module):
    """The activation map with the outputs of the other models."""

    def __init__(self, net: WeakNet) -> None:
        super().__init__()
        self.net = net

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        p = torch.sigmoid(self.net.activation(x) + self.net.offset)
        p = functional.interpolate(p, scale_factor=float(_STRIDE), mode="nearest")
        rest = 1 - p
        return torch.cat([rest, 0 * p, 0 * p, p, 0 * p], 1)


def batches(
    cells: list[LabelledCell], batch: int, seed: int
) -> Iterator[tuple[torch.Tensor, torch.Tensor]]:
    """Draw batches without end: inputs (n, 1, 256, 256), and whether each has a crack (n,)."""
    rng, augment = np.random.default_rng(seed), Augmentation(degrade=False)
    small = [prepared(cell.image, cell.label) for cell in cells]
    cracked = np.array([int(cell.crack.sum()) >= CRACKED_PX for cell in cells])
    pools = [np.flatnonzero(cracked), np.flatnonzero(~cracked)]
    while True:
        drawn = [int(rng.choice(pools[k % 2])) for k in range(batch)]
        seen = [augment(*small[k], rng)[0] for k in drawn]
        yield (
            torch.from_numpy(np.stack(seen)[:, None]),
            torch.from_numpy(cracked[drawn].astype(np.float32)),
        )


def train_weak(
    cells: list[LabelledCell],
    judged: list[LabelledCell],
    out: Path,
    *,
    steps: int = 3000,
    batch: int = 16,
    seed: int = 0,
    judge_every: int = 500,
) -> WeakNet:
    """Train the network; figures about ``judged`` go to log.csv in ``out``.

    Parameters
    ----------
    cells, judged : list of LabelledCell
        Of the labels of ``cells`` only whether there is a crack is used.
    out : Path
    steps, batch, seed, judge_every : int

    Returns
    -------
    WeakNet
        With averaged weights.
    """
    torch.manual_seed(seed)
    net = WeakNet().to(memory_format=torch.channels_last)
    averaged = torch.optim.swa_utils.AveragedModel(
        net, multi_avg_fn=torch.optim.swa_utils.get_ema_multi_avg_fn(0.99), use_buffers=True
    )
    optimiser = torch.optim.AdamW(net.parameters(), 2e-3, weight_decay=1e-2)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, steps)
    out.mkdir(parents=True, exist_ok=True)
    log = []
    for step, (inputs, labels) in zip(
        range(1, steps + 1), batches(cells, batch, seed), strict=False
    ):
        net.train()
        optimiser.zero_grad()
        loss = functional.binary_cross_entropy_with_logits(net(inputs), labels)
        loss.backward()
        optimiser.step()
        schedule.step()
        averaged.update_parameters(net)
        if step % judge_every == 0 or step == steps:
            log.append({"step": step, **_figures(averaged.module, judged)})
            log[-1]["cpu_s"] = round(process_time())
            with (out / "log.csv").open("w", newline="", encoding="utf-8") as file:
                writer = csv.DictWriter(file, list(log[0]))
                writer.writeheader()
                writer.writerows(log)
    return averaged.module


@torch.no_grad()
def _figures(net: WeakNet, judged: list[LabelledCell]) -> dict[str, float]:
    """Of the cells: ROC-AUC of the pooled value. Of the blocks: AP and best F1."""
    net.eval()
    scores, pairs = [], []
    for cell in judged:
        image, label = prepared(cell.image, cell.label)
        x = torch.from_numpy(normalised(np.asarray(image, np.float32)))[None, None]
        scores.append(float(net(x)))
        p = _AsClasses(net)(x)[0, CRACK].numpy()
        pairs.append((p, label == CRACK))
    cracked = np.array([bool(cell.crack.any()) for cell in judged])
    coarse = coarse_score(pairs)
    return {
        "cell_auc": round(roc_auc(np.array(scores), cracked), 4),
        "coarse_ap": round(coarse.ap, 4),
        "coarse_f1": round(coarse.f1, 4),
        "instance_f1": round(coarse.instance_f1, 4),
    }


def main() -> None:
    """Train as the command line says."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("cells", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--steps", type=int, default=3000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--threads", type=int, default=2)
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    cells, judged = (read_labelled(options.cells / part) for part in ("train", "val"))
    net = train_weak(cells, judged, options.out, steps=options.steps, seed=options.seed)
    path = options.out / "network.onnx"
    export(_AsClasses(net), path)
    about = {
        "name": "weakly supervised network, trained on PV-Vision's cell labels",
        "sha256": hashlib.sha256(path.read_bytes()).hexdigest(),
        "classes": CLASSES,
        "calibration": {"slope": 1.0, "offset": 0.0},
        "operating_point": {"threshold": 0.5, "least_extent_cells": 0.05},
    }
    described = path.with_suffix(".json")
    described.write_text(json.dumps(about, indent=1) + "\n", encoding="utf-8")
    # The map has no calibrated pixels: its level is that of the best coarse F1.
    coarse = coarse_score(as_they_are(NetworkDetector(path), judged), block_px=25)
    about["operating_point"] = {"threshold": round(coarse.level, 4), "least_extent_cells": 0.05}
    described.write_text(json.dumps(about, indent=1) + "\n", encoding="utf-8")
    sys.stderr.write(f"coarse AP {coarse.ap:.3f}, F1 {coarse.f1:.3f}\n")


if __name__ == "__main__":
    main()
