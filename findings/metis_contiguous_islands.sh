#!/bin/sh
# One would guess: with contig=1 METIS keeps the parts of each component connected, and gives
# small components as a whole to a part: four parts of a street grid, and the car park on the
# island with one of them. Without contig such a graph is cut without complaint.
# What happens: contig=1 asks that all of the graph be connected. A city whose cameras have one
# island is refused, and the exception does not tell why ("Caught an unknown exception!"): METIS
# has written the reason to the process's standard error, past Python.
# Version: pymetis==2025.2.2 (METIS 5), networkx==3.6.1 for making graphs. Grid of 12 by 10 nodes,
# and the same with one of 2 by 2 beside it.
# Seen: grid 4 parts; with the island RuntimeError, and on standard error "A contiguous partition
# is requested for a non-contiguous input graph."
# camtopod: joins the components by pairs of the least weight before it cuts
# (camtopod/city/partition.py).
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
trap 'exit 1' INT TERM
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check \
  pymetis==2025.2.2 numpy==2.4.6 networkx==3.6.1
cat > "$folder/run.py" <<'PYTHON'
import subprocess
import sys

CUT = """
import sys
import networkx, pymetis
grid = networkx.convert_node_labels_to_integers(networkx.grid_2d_graph(12, 10))
if sys.argv[1] == "island":
    island = networkx.convert_node_labels_to_integers(networkx.grid_2d_graph(2, 2))
    grid = networkx.disjoint_union(grid, island)
neighbours = [list(grid[node]) for node in range(len(grid))]
options = pymetis.Options(contig=1, seed=1)
try:
    _, part = pymetis.part_graph(4, neighbours, recursive=False, options=options)
    print(len(set(part)), "parts")
except RuntimeError as error:
    print("RuntimeError:", error)
"""


def answer(name):
    """Return what Python is told, and whether standard error has the reason."""
    process = subprocess.run([sys.executable, "-c", CUT, name], capture_output=True, text=True)
    return process.stdout.strip(), "non-contiguous input graph" in process.stderr


outcome = {name: answer(name) for name in ("grid", "island")}
print(f"pymetis 2025.2.2: (answer, reason on standard error) {outcome}")
expectation = {
    "grid": ("4 parts", False),
    "island": ("RuntimeError: Caught an unknown exception!", True),
}
if outcome != expectation:
    sys.exit(f"changed: expected {expectation}; seen {outcome}")
PYTHON
cd "$folder"
timeout 100 venv/bin/python run.py
