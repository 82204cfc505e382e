"""How like the real videos are our physics and our agents?

    python benchmarks/realism.py COMMAND [--json FILE]

* ``replay``: the real agents' recovered actions through our physics, open loop.
* ``ahead``: the same for a few steps from each recorded state, by holds and walls.
* ``decisions``: would our agents do what the real ones did, state by state?
* ``side``: simulated and real trajectories under the true hypothesis.
* ``hypotheses``: does the true pair of goals explain the video better than wrong pairs?
* ``paired``: two reports of ``hypotheses``, compared video by video.
"""

from __future__ import annotations

import common
from videos import ahead, decisions, hypotheses, paired, replay, side


def main() -> None:
    parser = common.parser(__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    for part in (replay, ahead, decisions, side, hypotheses, paired):
        name = part.__name__.rpartition(".")[2]
        command = commands.add_parser(name, help=(part.__doc__ or "").splitlines()[0])
        part.add_options(command)
        common.add(command, "json")
        command.set_defaults(part=part)
    options = parser.parse_args()
    common.write(options.part.main(options), options.json)


if __name__ == "__main__":
    main()
