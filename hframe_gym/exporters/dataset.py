"""Episodes of controllers as data sets for offline reinforcement learning (Minari)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from typing_extensions import override

from .. import option_texts
from ..errors import InputError
from ..files import output_folder
from ..line_log import LineLog
from ..machine import Machine
from ..option_texts import MAX_EPISODES, MAX_SEED
from .base import EXPORTERS, Exporter, argument, option


@EXPORTERS.register("dataset")
@dataclass(frozen=True, kw_only=True)
class DatasetExporter(Exporter):
    """Write episodes of controllers as offline reinforcement learning data sets (Minari), one per controller.

    Example:  hframe export dataset pid ppo --episodes 100 --out out/minari
    """

    controllers: list[str] = argument(
        "Controllers: {controllers}, random (random actions), a shipped agent ({agents}), "
        "the folder of a trained agent, or module:name."
    )
    machine: str | Path | Machine = option("hframe", option_texts.MACHINE, cli_type=str)
    task: str = option("reach", option_texts.TASK)
    randomize: str = option("none", option_texts.RANDOMIZE)
    sensors: str = option("state", option_texts.SENSORS)
    period: float = option(0.01, option_texts.PERIOD)
    episodes: int = option(100, option_texts.EPISODES, least=1, most=MAX_EPISODES)
    seed: int = option(0, "Seed of the first episode; episode i has the seed + i.", least=0, most=MAX_SEED)
    normalize: bool = option(False, "Store observations and goals divided by their scales.")
    flat: bool = option(False, "Store an observation as one array instead of a dict.")
    author: str | None = option(None, "Author in the metadata of the data sets.")
    reference: bool = option(
        False, "Store reference scores: mean returns of random actions and of the controller predictive."
    )

    @override
    def write(self, out: str | Path, log: LineLog = lambda line: None) -> None:
        """Write the data sets; each appears when it is complete.

        Raises:
            InputError: If an option or the name of a controller is wrong (then nothing is written), or an
                episode fails.
        """
        from ..evaluation import Scenario, dataset_controller, export_dataset

        out = output_folder(out)
        options: dict[str, Any] = {
            key: getattr(self, key) for key in ("randomize", "sensors", "episodes", "seed")
        }
        names = list(dict.fromkeys(self.controllers))
        try:
            scenario = Scenario(self.machine, self.task, period=self.period, **options)
            for name in names:  # so that a wrong name is reported before anything is written
                dataset_controller(name, scenario)
            for name in names:
                form: dict[str, Any] = {"normalize": self.normalize, "flat": self.flat, "author": self.author}
                form["reference"] = self.reference
                written = export_dataset(name, scenario, out, **form)
                log(
                    f"wrote {written.dataset_id}: {written.episodes} episodes, {written.steps} steps, mean "
                    f"return {written.mean_return:.2f}, {written.success_rate:.1%} of the episodes end "
                    "within the task's band"
                )
        except ValueError as error:
            raise InputError(str(error)) from error
        log(
            f"load them in Python with MINARI_DATASETS_PATH={out} "
            f"and minari.load_dataset({written.dataset_id!r})"
        )
