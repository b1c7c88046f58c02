"""Regenerate the gallery pages under docs/gallery: text, numbers and images.

`python tools/gallery.py` writes every page, `python tools/gallery.py touch-point unified` the named ones.
Each page runs the commands that it shows, so that text, numbers and images come from the present code.
`rendered-scanner` and the scans of `unified` keep their parts in docs/gallery/.parts and resume there; all pages
together take hours.
"""

import sys
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))
PARTS = ROOT / "docs" / "gallery" / ".parts"


def laser_spot() -> None:
    """docs/gallery/laser-spot.md: Liu, Shi & Ding 2014."""
    import gallery_laser_spot as figures
    import gallery_laser_spot_page as text

    exact = figures.liu.irb120(6, 7)
    first, second = figures.fit(exact, False), figures.fit(exact, True)
    text.draw_image(first, second, figures.HERE / "laser-spot.png")
    page = text.page(exact, first, second)
    (figures.HERE / "laser-spot.md").write_text(page, encoding="utf-8")


def touch_point() -> None:
    """docs/gallery/touch-point.md: Gubankov & Yukhimets 2022."""
    import gallery_touch_point as figures
    import gallery_touch_point_page as text

    many = figures.paired(100)
    text.draw_image(many, figures.HERE / "touch-point.png")
    (figures.HERE / "touch-point.md").write_text(text.page(many), encoding="utf-8")


def partial_pose() -> None:
    """docs/gallery/partial-pose.md: Mathematics 2023, 11, 4802."""
    import gallery_partial_pose

    gallery_partial_pose.main()


def poses_and_compensation() -> None:
    """docs/gallery/poses-and-compensation.md: choice of poses, compensation, exports."""
    import gallery_use as figures
    import gallery_use_page as text

    said, answers, pools, cases = figures.collect()
    first = [pools[name][0] for name in figures.ILLUSTRATED]
    text.draw_image(first, cases[0], figures.PAGE.with_suffix(".png"))
    page = text.page(said, answers, figures.gains(), pools, cases)
    figures.PAGE.write_text(page, encoding="utf-8")


def unified() -> None:
    """docs/gallery/unified-kinematic-compliance.md: Ye et al. 2024."""
    import gallery_ye as figures
    import gallery_ye_page as text
    import gallery_ye_scanner as scanner
    import gallery_ye_sections as sections

    found = scanner.collect(PARTS)
    answers, draws, made = figures.collect(sections.recordings)
    errors = sections.held_out_errors(made)
    sections.draw_all(made, errors, found)
    paper = sections.texts(made, errors, found)
    page = text.page(answers, draws, figures.readings(), figures.printed_sign(), paper)
    figures.PAGE.write_text(page, encoding="utf-8")


def rendered_scanner() -> None:
    """docs/gallery/rendered-scanner.md: a rendered scanner after Ye et al. 2024."""
    import gallery_rendered_scanner as figures
    import gallery_rendered_scanner_page as text

    text.write(figures.collect(PARTS), figures.EFFECTS)


PAGES: dict[str, Callable[[], None]] = {
    "laser-spot": laser_spot,
    "touch-point": touch_point,
    "partial-pose": partial_pose,
    "poses-and-compensation": poses_and_compensation,
    "unified": unified,
    "rendered-scanner": rendered_scanner,
}


def main(names: list[str]) -> int:
    """Write the named pages, all where none is named; exit status 2 for an unknown name."""
    unknown = [name for name in names if name not in PAGES]
    if unknown:
        print(
            f"no gallery page is called {unknown[0]}: expected {', '.join(PAGES)}", file=sys.stderr
        )
        return 2
    for name in names or PAGES:
        print(name, flush=True)
        PAGES[name]()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
