"""New machines from templates: a built-in machine with other values, and comments on its file's fields."""

from .commented_file import write_machine_template
from .new_machine import new_machine
from .options import MachineOptions
from .questions import TemplateQuestion, template_questions
from .texts import TEMPLATES

__all__ = [
    "TEMPLATES",
    "MachineOptions",
    "TemplateQuestion",
    "new_machine",
    "template_questions",
    "write_machine_template",
]
