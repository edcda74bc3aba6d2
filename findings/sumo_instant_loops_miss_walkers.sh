#!/bin/sh
# One would guess: detectPersons="walk" makes an instant induction loop report each person who
# walks over it, with the time, as it makes an induction loop count them: the ground truth of a
# camera's door.
# What happens: the instant loop accepts the attribute and stays empty. The interval loop at the
# same place counts both walkers, and an instant loop on the road beside it sees the car. There is
# no warning.
# Version: eclipse-sumo==1.28.0. A road with a sidewalk, one car, two walkers.
# Seen: interval loop on the sidewalk 2, instant loop there 0, instant loop on the road 1.
# camtopod: has no reader of SUMO's detectors; crossings of people are to be taken from
# trajectories (--fcd-output), which `TrackEvents` turns into events as it does any tracker's
# boxes (camtopod/adapt/tracks.py).
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
trap 'exit 1' INT TERM
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check \
  eclipse-sumo==1.28.0
cat > "$folder/run.py" <<'PYTHON'
import subprocess
import sys
import xml.etree.ElementTree as xml
from pathlib import Path

FILES = {
    "site.nod.xml": '<nodes><node id="a" x="0" y="0"/><node id="b" x="200" y="0"/></nodes>',
    "site.edg.xml": '<edges><edge id="ab" from="a" to="b" numLanes="1" sidewalkWidth="2"/></edges>',
    "site.rou.xml": '<routes><route id="r" edges="ab"/><vehicle id="car" route="r" depart="0"/>'
    '<person id="one" depart="0"><walk edges="ab"/></person>'
    '<person id="two" depart="5"><walk edges="ab"/></person></routes>',
    "site.add.xml": "<additional>"
    '<instantInductionLoop id="road" lane="ab_1" pos="100" file="road.xml"/>'
    '<instantInductionLoop id="walk" lane="ab_0" pos="100" file="walk.xml" detectPersons="walk"/>'
    '<inductionLoop id="hour" lane="ab_0" pos="100" period="3600" file="hour.xml"'
    ' detectPersons="walk"/></additional>',
}
programs = Path(sys.executable).parent
for name, text in FILES.items():
    Path(name).write_text(text)
network = ("-n", "site.nod.xml", "-e", "site.edg.xml", "-o", "site.net.xml")
simulation = ("-n", "site.net.xml", "-r", "site.rou.xml", "-a", "site.add.xml", "--end", "300")
subprocess.run([programs / "netconvert", *network], check=True, stdout=subprocess.DEVNULL)
subprocess.run([programs / "sumo", *simulation, "--no-step-log"], check=True)
hour = sum(int(one.get("nVehEntered")) for one in xml.parse("hour.xml").iter("interval"))
walk, road = (
    sum(one.get("state") == "enter" for one in xml.parse(f"{name}.xml").iter("instantOut"))
    for name in ("walk", "road")
)
outcome = f"sidewalk: interval loop {hour}, instant loop {walk}; road: instant loop {road}"
print(f"SUMO 1.28.0: {outcome}")
expectation = "sidewalk: interval loop 2, instant loop 0; road: instant loop 1"
if outcome != expectation:
    sys.exit(f"changed: expected {expectation}; seen {outcome}")
PYTHON
cd "$folder"
timeout 100 venv/bin/python run.py
