"""Commands of the command line: options that may be given once, and help with options in groups and an example.

On a terminal rich draws the groups as panels; elsewhere they are sections of plain text.
"""

from collections import Counter

from typer.core import TyperCommand, TyperGroup

# Options that no group names are the common ones of a command: they come first, without a heading.
GROUPS = {
    "Model": (
        "--from-diagnosis",
        "--without",
        "--folds",
        "--scanner",
        "--camera",
        "--hand-eye",
        "--model",
        "--baseline",
        "--kind",
        "--urdf",
        "--tip",
        "--start",
    ),
    "Data": (
        "--fit-samples",
        "--test-samples",
        "--session",
        "--later",
        "--artefact",
        "--ball-radius",
        "--sigma",
        "--time-offset",
        "--title",
        "--trust-data",
    ),
    "Sensor and robot": ("--link-radius", "--stand-off", "--field", "--cap", "--repeats"),
    "Limits": (
        "--tolerance",
        "--max-correction-mm",
        "--max-correction-deg",
        "--max-sigma-mm",
        "--max-joint-change-deg",
        "--force",
    ),
    "Output": ("--json", "--no-report", "--page", "--truth", "--parent-frame", "--child-frame"),
    "Computation": ("--jobs", "--workers", "--scheduler", "--run", "--seed", "--minutes"),
}
_GROUP_OF = {option: group for group, options in GROUPS.items() for option in options}
_ORDER = [None, *GROUPS]


class Command(TyperCommand):
    """A command whose options are in the groups of `GROUPS`; an option with one value is accepted once."""

    def __init__(self, *args, **options) -> None:
        super().__init__(*args, **options)
        for parameter in self.params:
            if parameter.param_type_name == "option":
                parameter.rich_help_panel = _GROUP_OF.get(parameter.opts[0])
        paragraphs = (self.help or "").split("\n\n")
        self.help = "\n\n".join(" ".join(paragraph.split()) for paragraph in paragraphs)
        self.params.sort(key=lambda parameter: _ORDER.index(parameter.rich_help_panel))

    def parse_args(self, ctx, args: list[str]) -> list[str]:
        """Read the words of a call; an option that takes one value and is given twice is a wrong call."""
        problem = self._first_repeated(ctx, args)
        if problem is not None:
            ctx.fail(problem)
        return super().parse_args(ctx, args)

    def _first_repeated(self, ctx, args: list[str]) -> str | None:
        """Error message for the first option that is given twice, of which only the last value would be used."""
        *_, order = self.make_parser(ctx).parse_args(args=list(args))
        for parameter, count in Counter(order).items():
            is_option = parameter.param_type_name == "option"
            if count < 2 or not is_option or parameter.multiple or parameter.is_flag:
                continue
            form = parameter.get_help_record(ctx)[0].split(",")[-1].strip()
            return f"{parameter.opts[0]} is given {count} times; expected it once ({form}); leave out the others"
        return None

    def format_options(self, ctx, formatter) -> None:
        """Write arguments, then one section of plain text for each group of options."""
        sections = {"Arguments": [], "Options": []}
        for parameter in self.get_params(ctx):
            record = parameter.get_help_record(ctx)
            if record is None:
                continue
            is_argument = parameter.param_type_name == "argument"
            title = "Arguments" if is_argument else parameter.rich_help_panel or "Options"
            sections.setdefault(title, []).append(record)
        write_sections(formatter, sections)


class Group(TyperGroup):
    """A group of commands that lists them under the headings of `rich_help_panel`."""

    def format_commands(self, ctx, formatter) -> None:
        """Write one section of plain text for each heading."""
        limit = formatter.width - 6 - max(map(len, self.commands))
        sections: dict[str, list] = {}
        for name in self.list_commands(ctx):
            command = self.get_command(ctx, name)
            title = command.rich_help_panel or "Commands"
            sections.setdefault(title, []).append((name, command.get_short_help_str(limit)))
        write_sections(formatter, sections)


def write_sections(formatter, sections: dict[str, list[tuple[str, str]]]) -> None:
    """Write a heading and a list of definitions for each section that has entries."""
    for title, records in sections.items():
        if records:
            with formatter.section(title):
                formatter.write_dl(records)
