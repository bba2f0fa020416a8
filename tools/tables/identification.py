"""Tables of the results of identification: rigs of simulators, real machines, formulas."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from tools.tables.result_tables import load_results, markdown, table

STAGES = ("declared", "before", "after")
RANDOM_RIGS = "random_rigs_20271168"  # that is: of this seed, which was run once, for the published results
RANDOM_RIGS_CLOSED = "random_rigs_closed_20271167"
RANDOM_RIG_KINDS = {
    "clean": "library effects or none",
    "residue": "the same, with a residue",
    "off_form": "effects 10 to 20 % off the library's form",
    "outside": "effects outside the library",
}
IDENTIFICATION_SETS = (
    "library_full",
    "library_small",
    "pairs",
    "triples",
    "four_runs",
    "order20",
    "none",
    "outside",
)


def _codes(words: Iterable[str]) -> str:
    """Format words as code, separated by commas."""
    return ", ".join(f"`{word}`" for word in words)


def _correct(row: dict[str, Any]) -> str:
    """Return whether an identification named all effects and no other: "yes", or what is wrong."""
    wrong = [*(["missed"] if not row["complete"] else []), *(["extra"] if row["extra"] else [])]
    return ", ".join(wrong) or "yes"


@table("identify_examples")
def identify_examples(results: dict[str, Any]) -> str:
    """Format the held-out errors of the shipped rigs by channel."""
    rows = []
    for rig in ("rig_a", "rig_b"):
        for channel in results[rig]["after"]["held_out"]:
            ratios = [results[rig][s]["held_out"][channel]["noise_ratio"] for s in STAGES]
            rows.append([f"`{rig}` ({results[rig]['verdict']}), {channel}", *(f"{r:.3g}" for r in ratios)])
    return markdown(["rig and channel", "declared", "before: refitted", "after"], rows)


@table("identification")
def identification(results: dict[str, Any]) -> str:
    """Format the summaries of all sets of rigs, one per row."""
    rows = []
    for name, summary in results["sets"].items():
        median, parameters = summary["median"], summary["parameters"]
        rows.append(
            [
                name,
                f"{summary['rigs']}",
                f"{summary['scores']['right']}",
                f"{summary['named_not_there']}",
                f"{median['before']:.3g}",
                f"{median['after']:.3g}",
                f"{summary['to_noise']}",
                f"{parameters['within']} of {parameters['rigs']}" if parameters["rigs"] else "",
                f"{median['um_after']:.2g}",
                f"{median['seconds']:.1f}",
                f"{summary['most_seconds']:.0f}",
            ]
        )
    header = [
        "set",
        "rigs",
        "right",
        "false effects",
        "before",
        "after",
        "after <= 1.1",
        "parameters within 2 %",
        "tool error, um",
        "s",
        "slowest, s",
    ]
    return markdown(header, rows)


@table(*(f"identification_{name}" for name in IDENTIFICATION_SETS))
def identification_set(results: dict[str, Any]) -> str:
    """Format the rigs of a set: hidden effects, identified effects, errors and time."""
    rows = [
        [
            r["rig"],
            r["hides"] or "nothing",
            r["found"] or r["verdict"],
            "yes" if r["hit"] else "**no**",
            f"{r['before']:.3g}",
            f"{r['after']:.3g}",
            f"{r['seconds']:.1f}",
        ]
        for r in results["rigs"]
    ]
    return markdown(["rig", "hidden", "identified", "right", "before", "after", "s"], rows)


@table(RANDOM_RIGS, RANDOM_RIGS_CLOSED)
def random_rigs(results: dict[str, Any]) -> str:
    """Format names, errors, standard deviations and time on random rigs, in open or closed loop."""
    content = results["summary"]
    rows = []
    for key, title in RANDOM_RIG_KINDS.items():
        names, false = content["names"][key], content["false_names"][key]
        found = f"{names['identified']} of {names['effects']}" if names["effects"] else ""
        rows.append([title, str(names["rigs"]), str(names["right"]), found, str(false["with_false_name"])])
    table = markdown(["rigs", "number", "right", "effects identified", "rigs with a false name"], rows)
    above, unseen, seconds = content["names"]["above_detection"], content["unseen"], content["seconds"]["cpu"]
    intervals = content["coverage"]
    measures = [
        ["clean rigs: effects above the family's median detection size that are identified", ratio(above)],
        *(
            [f"{text}: median; 95 % quantile; share within {unseen[key]['limit']}", quantiles(unseen[key])]
            for key, text in (
                ("clean_over_noise", "clean rigs: error on unseen runs over the noise"),
                (
                    "residue_over_truth",
                    "rigs with a residue: error on unseen runs over that of the true machine",
                ),
            )
        ),
        *(
            [
                f"coverage of the 95 % intervals, {name}",
                f"{100 * found['95']:.0f} % of {found['parameters']} values",
            ]
            for name, found in intervals.items()
            if found["parameters"]
        ),
        ["written machine stable under random rated voltages", f"{content['stable']} of {content['rigs']}"],
        ["`hframe simulate` within 5 % of the report", f"{content['consistent']} of {content['rigs']}"],
        [
            "processor time of an identification: median; slowest",
            f"{seconds['median']:.0f} s; {seconds['most']:.0f} s",
        ],
    ]
    if content.get("logs"):
        measures[1:1] = _closed_loop_measures(content)
    if again := content.get("repeated_seconds", {}).get("cpu"):
        measures += [
            [
                "the same with compiled code, in a new process",
                f"{again['median']:.0f} s; {again['most']:.0f} s",
            ],
            ["report of the second identification is equal", f"{content['repeatable']} of {content['rigs']}"],
        ]
    return f"{table}\n\n{markdown(['measure', 'value'], measures)}"


def _closed_loop_measures(content: dict[str, Any]) -> list[list[str]]:
    """Return the rows of random rigs that only those in closed loop have."""
    above, errors = content["names"]["above_median_size"], content["unseen"]["over_truth"]
    size, within = f"{100 * above['size']:.0f} %", errors["limit"]
    text = "error on unseen runs over that of the true machine: median; 95 % quantile; share within"
    rows = [
        [
            "all rigs with library effects: effects with a trace, "
            f"larger than {size} (the median), identified",
            ratio(above),
        ],
        [
            "effects without a trace in the runs, which no method can find",
            str(content["names"]["without_trace"]["effects"]),
        ],
        [
            f"rigs with library effects, each with a trace, or without effects: {text} {within}",
            quantiles(errors),
        ],
    ]
    for name, found in content["logs"].items():
        rows.append(
            [f"log with {name} changes of the voltages a row: right", f"{found['right']} of {found['rigs']}"]
        )
        if found["over_truth"]["rigs"]:
            rows.append([f"the same: {text} {within}", quantiles(found["over_truth"])])
    return rows


def ratio(counts: dict[str, int]) -> str:
    """Format how many effects were identified."""
    return f"{counts['identified']} of {counts['effects']}"


def quantiles(values: dict[str, float]) -> str:
    """Format median, 95 % quantile and the fraction within the limit."""
    return f"{values['median']:.3g}; {values['p95']:.3g}; {100 * values['within']:.0f} %"


@table("random_rigs_totals", source=RANDOM_RIGS)
def random_rigs_totals(results: dict[str, Any]) -> str:
    """Format the totals of the random rigs, in open loop and under a position controller."""
    rows = []
    for title, content in (
        ("voltages as programmed", results["summary"]),
        ("voltages of a position controller", load_results(RANDOM_RIGS_CLOSED)["summary"]),
    ):
        names = [content["names"][key] for key in RANDOM_RIG_KINDS]
        false = sum(content["false_names"][key]["with_false_name"] for key in RANDOM_RIG_KINDS)
        total = {
            key: sum(counts[key] for counts in names) for key in ("rigs", "right", "identified", "effects")
        }
        rows.append([title, f"{total['rigs']}", f"{total['right']}", ratio(total), f"{false}"])
    header = ["rigs of an independent simulator", "number", "right", "effects identified"]
    return markdown([*header, "rigs with a false name"], rows)


@table("outside_library_3")
def outside_library(results: dict[str, Any]) -> str:
    """Format the rigs with an effect outside the library: names, errors on unseen runs, hints and time."""
    rows = []
    for r in results["rigs"]:
        hint = r["hint"]
        answer = _codes(r["named"] or [r["verdict"]])
        false = _codes(r["false"]) or ("verdict" if r["false_verdict"] else "")
        right = "right" if hint["right"] else "component" if hint["right_component"] else "wrong"
        text = f"{hint['component']}: {hint['variable']}" if hint["component"] else "none"
        errors = (f"{r['unseen'][machine]:.3g}" for machine in ("before", "after", "true"))
        loop = "closed" if r["closed_loop"] else "open"
        rows.append([r["hidden"], loop, answer, false, *errors, text, right, f"{r['cpu_seconds']:.0f} s"])
    header = [
        "hidden",
        "loop",
        "named",
        "false",
        "unseen runs: before",
        "after",
        "true",
        "hint",
        "",
        "processor time",
    ]
    content = results["summary"]
    counts = [
        ["rigs; families", f"{content['rigs']}; {content['families']}"],
        ["false names", f"{content['false_names']} on {content['rigs_with_false_names']} rigs"],
        ["`no_effect` above twice the noise", str(content["false_verdicts"])],
        ["hint at the right component", f"{content['hints_at_component']} of {content['rigs']}"],
        ["hint at the right component and variable", f"{content['hints_right']} of {content['rigs']}"],
        ["within 120 s of processor time", f"{content['within_budget']} of {content['rigs']}"],
    ]
    return f"{markdown(header, rows)}\n\n{markdown(['measure', 'value'], counts)}"


@table("other_simulator_rigs")
def other_simulator_rigs(results: dict[str, Any]) -> str:
    """Format the fourteen rigs of another simulator: truth, named effects, errors on unseen runs and time."""
    rows = []
    for r in results["rigs"]:
        errors = (f"{r['unseen'][machine]['mean']:.3g}" for machine in ("before", "after"))
        residue = "yes" if r["residue"] else ""
        named = _codes(r["named"]) or r["verdict"]
        rows.append([r["hidden"], residue, named, _correct(r), *errors, f"{r['seconds']['wall']:.0f} s"])
    header = ["hidden", "residue", "named", "right", "unseen runs: before", "after", "time"]
    return markdown(header, rows)


@table("closed_loop_rigs")
def closed_loop_rigs(results: dict[str, Any]) -> str:
    """Format the eight rigs with a position controller: truth, verdict, what is left, hint and time."""
    rows = []
    for r in results["rigs"]:
        hint = "" if r["hint"] is None else f"{r['hint']['component']}: {r['hint']['variable']}"
        errors = (f"{r['unseen'][machine]:.3g}" for machine in ("declared", "before", "after"))
        answer = _codes(r["named"] or [r["verdict"]])
        rows.append([r["hidden"], answer, _correct(r), hint, *errors, f"{r['cpu_seconds']:.0f} s"])
    header = [
        "hidden",
        "verdict",
        "right",
        "hint",
        "unseen runs: declared",
        "before",
        "after",
        "processor time",
    ]
    return markdown(header, rows)


@table("formulas")
def formulas(results: dict[str, Any]) -> str:
    """Format the rigs with a force or friction outside the library: table and proposed formula."""
    rows = []
    for name, rig in results["rigs"].items():
        if "formula" not in rig:
            rows.append([name, ", ".join(rig["tables"]) or "no table", *[""] * 5])
            continue
        seconds = f"{rig['seconds']['formulas']:.0f} s"
        errors = (f"{rig[key]:.3g}" for key in ("table_error", "formula_error"))
        rows.append([name, f"`{rig['tables'][0]}`", rig["terms"], f"{rig['complexity']}", *errors, seconds])
    header = [
        "hidden",
        "table",
        "formula",
        "parameters",
        "error: table",
        "error: formula",
        "time for formulas",
    ]
    return markdown(header, rows)


@table("public_axes")
def public_axes(results: dict[str, Any]) -> str:
    """Format the public recordings of motors and axes: errors of machines, fit to beat, verdict, time."""
    rows = []
    for r in results["sets"]:
        stages = ("declared", "plain", "before", "after", "reference")
        errors = ("-" if r["errors"][s] is None else f"{r['errors'][s]:.3g} {r['unit']}" for s in stages)
        ratio = "-" if r["ratio"] is None else f"{r['ratio']:.2f}"
        answer = _codes(r["named"] or [r["verdict"]])
        rows.append([f"{r['machine']} ({r['source']})", answer, *errors, ratio, f"{r['cpu_seconds']:.0f} s"])
    machines = ["declared", "plain fit", "refitted", "delivered", "to beat"]
    return markdown(["recordings", "verdict", *machines, "ratio", "processor time"], rows)


@table("real_machines_emps")
def real_machines_emps(results: dict[str, Any]) -> str:
    """Format the relative force errors of both EMPS records."""
    rows = [
        [name, *(f"{100 * e[k]:.2f} %" for k in ("train", "test"))]
        for name, e in results["force_error"].items()
    ]
    return markdown(["EMPS", "first record (fitted)", "second record (held out)"], rows)


@table("real_machines_ced")
def real_machines_ced(results: dict[str, Any]) -> str:
    """Format the simulation errors of the CED records, relative to their standard deviation."""
    rows = [[name, *(f"{100 * e:.0f} %" for e in by.values())] for name, by in results["nrmse"].items()]
    return markdown(["CED", *next(iter(results["nrmse"].values()))], rows)


@table("real_machines_xl330")
def real_machines_xl330(results: dict[str, Any]) -> str:
    """Format the simulation errors of the XL330 logs, rad rms."""
    rows = [[name, *(f"{e:.3g} rad" for e in by.values())] for name, by in results["rms_rad"].items()]
    return markdown(["XL330", *next(iter(results["rms_rad"].values()))], rows)
