#!/usr/bin/env bash
# Gather the wheels that a bare machine lacks which has Python 3.12, torch, NumPy, SciPy, Matplotlib and
# Hypothesis, and no network.
#
#     benchmarks/gpu_wheels.sh wheels        # here, with the network; then carry the folder there
#     python -m pip install --no-index --no-deps wheels/*.whl    # there, in the checkout, and then:
#     python -m pip install --no-index --no-deps --no-build-isolation -e .
#     python benchmarks/gpu.py --csv gpu.csv
set -euo pipefail
folder=${1:-wheels}
pip() { python -m pip "$@" --quiet --disable-pip-version-check; }
packages="kornia kornia_rs hydra-core<1.4,>=1.3.8 omegaconf<2.4 PyYAML tensorboard tensorboard-data-server absl-py
  grpcio markdown protobuf werkzeug MarkupSafe rich pygments markdown-it-py mdurl jinja2 pillow pytest iniconfig
  pluggy packaging setuptools"
mkdir -p "$folder"
pip wheel --no-deps --wheel-dir "$folder" "antlr4-python3-runtime==4.9.*"
# shellcheck disable=SC2086
pip download --no-deps --only-binary=:all: --python-version 3.12 --dest "$folder" $packages
du -sm "$folder" | awk '$1 > 64 { print "more than 64 MiB: " $1; exit 1 }'
