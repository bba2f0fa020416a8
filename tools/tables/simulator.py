"""Tables of what the simulator and the environments reach: accuracy, speed, plausibility."""

from __future__ import annotations

from typing import Any

from tools.tables.result_tables import markdown, table, with_interval


@table("paper")
def paper(results: dict[str, Any]) -> str:
    """Format the statements of the paper beside the values of the models."""
    rows = [list(row.values()) for row in results["statements"]]
    return markdown(["where", "the paper says", "the models give", "agrees"], rows)


@table("accuracy")
def accuracy(results: dict[str, Any]) -> str:
    """Format the tool errors of the kernel, and of MuJoCo with its best settings at the same step."""
    rows = []
    for voltage, errors in results["against_reference"].items():
        constant = results["constant_stiffness"].get(voltage, {}).get("median_errors_m")
        for step, error in errors["errors_m"].items():
            cells = [f"{1e6 * error[k]:.3g}" for k in ("median", "p95", "max")]
            if constant:
                rival = min(values[step] for name, values in constant.items() if name != "this kernel")
                cells += [f"{1e6 * rival:.4g}", f"{rival / constant['this kernel'][step]:.0f}"]
            else:
                cells += ["", ""]
            rows.append([f"+-{voltage}, {step}", *cells])
    header = ["voltages, step", "median um", "p95 um", "max um", "MuJoCo's median um, best settings", "ratio"]
    return markdown(header, rows)


@table("throughput")
def throughput(results: dict[str, Any]) -> str:
    """Format the steps per second of the kernel and of MuJoCo's rollout."""
    rows = [
        [
            name,
            *(f"{1e-6 * r[k]:.3g}" for k in ("ours_steps_per_s", "theirs_steps_per_s")),
            with_interval(r["ratio"], *r["spread"], decimals=0),
        ]
        for name, r in results["mujoco"].items()
        if "ratio" in r
    ]
    return markdown(["stage; MuJoCo's settings; cores", "kernel, M/s", "MuJoCo, M/s", "ratio"], rows)


@table("differentiable")
def differentiable(results: dict[str, Any]) -> str:
    """Format the speed of differentiated steps, and their errors."""
    rows = []
    for row in results["rates"]:
        low, high = row["spread"]
        rows.append(
            [
                row["machine"],
                row["friction"],
                "state, voltages" + (", parameters" if row["by_parameters"] else ""),
                f"{row['ours_steps_per_s']:.0f}",
                with_interval(1.0 / row["ratio"], 1.0 / high, 1.0 / low, decimals=1),
            ]
        )
    header = ["machine", "friction", "with respect to", "differentiated steps/s", "cost in simulated steps"]
    errors = [
        [name, f"{e['median']:.1e}", f"{100 * e['fraction_below_1e-6']:.1f} %"]
        for name, e in results["errors"].items()
    ]
    compared = markdown(
        ["machine", "median relative error against central differences", "below 1e-6"], errors
    )
    return f"{markdown(header, rows)}\n\n{compared}"


@table("env_speed")
def env_speed(results: dict[str, Any]) -> str:
    """Format the environment's speed relative to other environments, and the kernel's fraction of a step."""
    rows = []
    for name, result in results.items():
        if name.startswith(("over EnvPool", "single over")):
            rows.append([name, with_interval(result["ratio"], *result["spread"], decimals=2)])
        elif name.startswith("share of"):
            fractions = (
                f"{100 * result[clock]['share']:.0f} % of {clock} time" for clock in ("processor", "wall")
            )
            rows.append(
                [
                    name.replace("share of the bare kernel", "fraction of the bare kernel"),
                    ", ".join(fractions),
                ]
            )
    return markdown(["measure", "value"], rows)


@table("env_soak")
def env_soak(results: dict[str, Any]) -> str:
    """Format the extremes of the long runs of the environment."""
    parts = {
        name: part for name, part in results.items() if isinstance(part, dict) and "largest_energy_J" in part
    }
    rows = [
        [
            name,
            f"{part['steps']:.3g}",
            f"{part['not_finite']}",
            f"{1e3 * part['furthest_beyond_m']:.1f}",
            f"{part['largest_energy_J']:.1f} of {part['energy_bound_J']:.0f}",
            f"{part['memory']['last_MB'] - part['memory']['first_MB']:+.0f}",
        ]
        for name, part in parts.items()
    ]
    total = sum(part["steps"] for part in parts.values())
    rows.append(["all", f"{total:.3g}", f"{sum(part['not_finite'] for part in parts.values())}", "", "", ""])
    header = [
        "machines",
        "steps",
        "not finite",
        "furthest beyond the workspace, mm",
        "largest energy, J",
        "memory, MB",
    ]
    return markdown(header, rows)


@table("first_step")
def first_step(results: dict[str, Any]) -> str:
    """Format the processor time to the first step of an environment."""
    rows = [
        [f"`{name}`", *(f"{times[key]:.1f} s" for key in ("empty_s", "filled_s"))]
        for name, times in results["cases"].items()
    ]
    return markdown(["`gym.make` with", "empty cache", "filled cache"], rows)
