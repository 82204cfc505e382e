"""The simulator beside real videos: python benchmarks/realism.py COMMAND [--json FILE]

replay      open loop: the recovered actions of the real agents through our physics
ahead       likewise, a few steps from each recorded state, by who holds what and where
decisions   teacher-forced: would our agents do what the real ones did, state by state?
side        closed loop: simulated and real trajectories under the true hypothesis
hypotheses  does the true pair of goals explain the video better than wrong ones?
paired      two reports of `hypotheses`, such as of two planners, video by video
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
