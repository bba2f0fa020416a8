"""How far does a controller close the gap to a plant that its model does not describe? The protocol `gap-v1`.

    python -m benchmarks.gap run pid pid-corrected my.module:MyEntry    # scores go to benchmarks/gap/results
    python -m benchmarks.gap run my_reach.zip+my_track.zip      # saved policies, for moves and for paths
    python -m benchmarks.gap run pid --plants 0 1 --out DIR             # some plants, another folder
    python -m benchmarks.gap run pid --again       # plants that another commit scored are scored again
    python -m benchmarks.gap run pid --seed 48000    # other plants: benchmarks/gap/results/48000
    python -m benchmarks.gap table         # write benchmarks/results/gap.json from the result files
    python -m benchmarks.gap table --seed 48000    # benchmarks/results/gap_48000.json
    python -m benchmarks.gap trained --out DIR    # NAME-trained and NAME-corrected: results/gap_trained.json
    python -m benchmarks.gap list | plants | bounds | picture

A run that ends early continues where it ended. Where the source of an entry has changed, its plants are
scored again; rows of plants that a run leaves out stay, and say which code scored them. A plant that an entry
refuses has a row with the reason, and the run goes on with the next one. Identified machines and trained
agents are kept in out/gap.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from benchmarks.gap import bounds, protocol, results
from benchmarks.gap.catalog import entry_names, get_entry
from benchmarks.gap.plants import COUNT, PUBLIC_SEED, draw_plant
from benchmarks.gap.summary import RESULTS, overview, read_all, summarize, trained_against_corrected
from benchmarks.results_file import write_results
from hframe_gym.errors import InputError
from tools.command_line import command_line
from tools.repository import ROOT

CACHE = ROOT / "out" / "gap"
ACTIONS = ("run", "table", "trained", "list", "plants", "bounds", "picture")


def run(
    name: str, seed: int, indices: list[int], out: Path, cache: Path = CACHE, again: bool = False
) -> Path:
    """Score an entry and write its result file after every plant.

    Args:
        name: Name of the entry.
        indices: Numbers of the plants.
        out: Folder of the result file.
        cache: Folder of identified machines and trained agents.
        again: Whether plants that another commit scored are scored again.

    Returns:
        Path of the file.

    Raises:
        InputError: If there is no such entry, or the folder holds its results on plants of another seed.
    """
    make = get_entry(name)
    name = make.name or name
    path = out / f"{''.join(c if c.isalnum() or c in '-_.' else '-' for c in name)}.json"
    content = results.new_content(name, make, seed)
    if path.is_file():
        before = results.read(path)
        if before["seed"] != seed:
            raise InputError(
                f"{path} holds results on plants of seed {before['seed']}; name another folder with --out"
            )
        content["plants"] = results.kept_rows(before, content["entry"]["sha256"])
    scored_by = results.commit()
    done = {
        row["plant"]: row
        for row in content["plants"]
        if "sha256" not in row and "refused" not in row and (not again or row.get("commit") == scored_by)
    }

    def keep(row: dict[str, object]) -> None:
        others = [other for other in content["plants"] if other["plant"] != row["plant"]]
        content["plants"] = [*others, {**row, "commit": scored_by}]
        results.write(path, content)
        print(f"{name} plant {row['plant']}{': ' * ('refused' in row)}{row.get('refused', '')}", flush=True)

    others = [other for other in read_all(out).values() if other["seed"] == seed]
    rows = [row for other in others for row in other["plants"] if row.get("commit") == scored_by]
    known = {(row["plant"], row["key"]): row for row in rows if "key" in row}
    protocol.score_plants(make, seed, indices, cache, done, known, keep)
    return path


def of_seed(contents: dict[str, dict[str, Any]], seed: int, folder: Path) -> dict[str, dict[str, Any]]:
    """Return result files by name, as `read_all` returns them, if all are on plants of a seed.

    Args:
        folder: Folder of the files, for the message.

    Raises:
        InputError: If there is no file, or one on plants of another seed.
    """
    if not contents:
        raise InputError(f"{folder} holds no results; write some with python -m benchmarks.gap run")
    for name, content in contents.items():
        if content["seed"] != seed:
            raise InputError(
                f"{folder}: the results of {name} are on plants of seed {content['seed']}, not {seed}; "
                f"state --seed {content['seed']}, and name a folder with plants of one seed with --out"
            )
    return contents


def compute_bounds(seed: int, indices: list[int]) -> None:
    """Compute the bounds of plants that have none, and write them after every plant.

    Args:
        indices: Numbers of the plants.
    """
    rows = bounds.rows(seed)
    for index in indices:
        if any(row["plant"] == index for row in rows):
            continue
        plant = draw_plant(seed, index)
        drawn = protocol.starts(plant, "reach")
        rows.append(bounds.compute(plant, drawn.start, drawn.plan))
        bounds.write(seed, rows)
        print(rows[-1], flush=True)


def main() -> None:
    """Run what the command line asks for."""
    parser = command_line(__doc__)
    parser.add_argument("action", choices=ACTIONS)
    parser.add_argument(
        "entries",
        nargs="*",
        metavar="ENTRY",
        help="`list` names them, or REACH+TRACK, or package.module:Class",
    )
    parser.add_argument(
        "--plants",
        type=int,
        nargs="+",
        choices=range(COUNT),
        default=list(range(COUNT)),
        metavar="INDEX",
        help=f"some plants, 0 to {COUNT - 1} (default: all)",
    )
    parser.add_argument(
        "--seed", type=int, default=PUBLIC_SEED, help="of the plants (default: those of gap-v1)"
    )
    parser.add_argument(
        "--out",
        type=Path,
        help="folder of the result files (default: benchmarks/gap/results, of another seed its folder SEED)",
    )
    parser.add_argument(
        "--again", action="store_true", help="run: score plants again that another commit scored"
    )
    arguments = parser.parse_args()
    held = arguments.seed != PUBLIC_SEED
    out = arguments.out or (RESULTS / f"{arguments.seed}" if held else RESULTS)
    try:
        if arguments.action == "run":
            protocol.check()
            if not arguments.entries:
                raise InputError("run needs at least one entry; python -m benchmarks.gap list names them")
            for name in arguments.entries:
                run(name, arguments.seed, arguments.plants, out, again=arguments.again)
        elif arguments.action == "list":
            print("\n".join(entry_names()))
        elif arguments.action == "plants":
            for index in arguments.plants:
                print(f"{index:2d} {draw_plant(arguments.seed, index).describe()}")
        elif arguments.action == "bounds":
            compute_bounds(arguments.seed, arguments.plants)
        elif arguments.action == "picture":
            from benchmarks.gap.picture import draw

            print(draw(read_all(out)))
        if arguments.action in ("run", "table"):
            print(overview(read_all(out)))
        if arguments.action == "table":
            content = summarize(of_seed(read_all(out), arguments.seed, out))
            print(write_results(f"gap_{arguments.seed}" if held else "gap", content, seed=arguments.seed))
        if arguments.action == "trained":
            content = trained_against_corrected(read_all(out))
            print(write_results("gap_trained", content, seed=arguments.seed))
    except InputError as error:
        sys.exit(f"{error}")


if __name__ == "__main__":
    main()
