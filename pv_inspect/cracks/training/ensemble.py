"""Join crack networks into one ONNX file whose answer is the mean of theirs, and describe it.

    python -m pv_inspect.cracks.training.ensemble CELLS OUT NETWORK NETWORK ... [--name NAME]

Each NETWORK is an ONNX file of ours with its description beside it. OUT gets network.onnx and
network.json: calibration, operating point and evidence are fitted anew on the validation cells of
CELLS; the known looks are those of the first network that has any. Networks from different random
starts err at different places, so that their mean [1]_ errs less, on cells of other cameras above
all. Needs ``pip install "pv-inspect[train]"``.

References
----------
.. [1] B. Lakshminarayanan, A. Pritzel, C. Blundell, "Simple and Scalable Predictive Uncertainty
       Estimation using Deep Ensembles", NeurIPS 2017.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import onnx
from onnx import compose, helper, numpy_helper

from pv_inspect.cracks.looks import KnownLooks
from pv_inspect.cracks.network import CrackModel
from pv_inspect.cracks.training.labelled import read_labelled

__all__ = ["join"]

_OUTPUT = "probabilities"


def join(networks: Sequence[Path], out: Path) -> None:
    """Write a network whose probabilities are the mean of those of others.

    Parameters
    ----------
    networks : sequence of Path
        ONNX files as `pv_inspect.cracks.training.train.write_onnx` writes them, at least two.
    out : Path

    Raises
    ------
    ValueError
        If there are fewer than two.
    """
    if len(networks) < 2:
        raise ValueError(f"{len(networks)} networks were given, a mean needs at least two")
    parts = [
        compose.add_prefix(onnx.load(path), f"n{k}/", rename_inputs=False)
        for k, path in enumerate(networks)
    ]
    nodes = [node for part in parts for node in part.graph.node]
    weights = [array for part in parts for array in part.graph.initializer]
    weights.append(numpy_helper.from_array(np.float32(1 / len(parts)), "share"))
    total = f"n0/{_OUTPUT}"
    for k in range(1, len(parts)):
        nodes.append(helper.make_node("Add", [total, f"n{k}/{_OUTPUT}"], [f"sum{k}"]))
        total = f"sum{k}"
    nodes.append(helper.make_node("Mul", [total, "share"], [_OUTPUT]))
    answer = onnx.ValueInfoProto()
    answer.CopyFrom(parts[0].graph.output[0])
    answer.name = _OUTPUT
    graph = helper.make_graph(nodes, "mean", [parts[0].graph.input[0]], [answer], weights)
    model = helper.make_model(graph, opset_imports=parts[0].opset_import)
    model.ir_version = parts[0].ir_version
    onnx.checker.check_model(model)
    out.parent.mkdir(parents=True, exist_ok=True)
    onnx.save(model, out)


def _looks_of(networks: Sequence[Path]) -> KnownLooks | None:
    looks = (CrackModel.read(path).looks for path in networks)
    return next((one for one in looks if one is not None), None)


def main() -> None:
    """Join and describe as the command line says."""
    from pv_inspect.cracks.training.train import describe  # torch is slow to load

    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("cells", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("networks", type=Path, nargs="+")
    parser.add_argument("--name", default="mean of networks trained on own cells")
    options = parser.parse_args()
    path = options.out / "network.onnx"
    join(options.networks, path)
    describe(
        path,
        options.name,
        read_labelled(options.cells / "val"),
        looks=_looks_of(options.networks),
    )


if __name__ == "__main__":
    main()
