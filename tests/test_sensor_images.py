"""Images read as grey: what is converted, what is refused with a sentence, and what is rejected by name."""

import cv2
import numpy as np
import pytest

from sensors import images
from workbench.core.errors import InputError

SCENE = np.add.outer(np.arange(40), 3 * np.arange(60)).astype(np.uint8)


def saved(folder, name, image):
    """The file that OpenCV writes."""
    assert cv2.imwrite(str(folder / name), image)
    return folder / name


@pytest.mark.parametrize("name", ["a.png", "a.tiff", "a.bmp"])
def test_eight_bits_come_as_they_are(tmp_path, name):
    found = images.read(saved(tmp_path, name, SCENE))
    np.testing.assert_array_equal(found.grey, SCENE)
    assert (found.grey.dtype, found.full, found.note, found.size) == (np.uint8, 255, "", (60, 40))


def test_sixteen_bits_keep_their_counts_and_know_their_full_scale(tmp_path):
    """A 12-bit camera in 16-bit files is full at 4095, not at 65535."""
    deep = SCENE.astype(np.uint16) * 18
    deep[:4] = 4095
    found = images.read(saved(tmp_path, "deep.png", deep))
    np.testing.assert_array_equal(found.grey, deep)
    assert found.full == 4095 and found.saturated == pytest.approx(0.1)
    assert found.note == "16-bit, full scale 4095"


def test_colour_is_converted_with_a_note_and_alpha_dropped(tmp_path):
    colour = np.dstack([SCENE, SCENE // 2, 255 - SCENE])
    found = images.read(saved(tmp_path, "c.png", colour))
    np.testing.assert_array_equal(found.grey, cv2.cvtColor(colour, cv2.COLOR_BGR2GRAY))
    assert found.note == "colour converted to grey"
    seen = images.read(saved(tmp_path, "d.png", np.dstack([colour, SCENE])))
    np.testing.assert_array_equal(seen.grey, found.grey)
    assert seen.note == "colour converted to grey; alpha dropped"


@pytest.mark.parametrize(("channel", "layer"), [("blue", 0), ("green", 1), ("red", 2)])
def test_one_channel_of_a_colour_image(tmp_path, channel, layer):
    colour = np.dstack([SCENE, SCENE // 2, 255 - SCENE])
    path = saved(tmp_path, "c.png", colour)
    np.testing.assert_array_equal(images.read_grey(path, channel=channel), colour[:, :, layer])


def test_three_equal_channels_are_one(tmp_path):
    found = images.read(saved(tmp_path, "e.png", np.dstack([SCENE] * 3)))
    np.testing.assert_array_equal(found.grey, SCENE)
    assert found.note == "three equal channels"


def broken(folder, how):
    whole = {
        k: saved(folder, f"w{k}", SCENE).read_bytes() for k in (".png", ".jpg", ".bmp", ".tiff")
    }
    content = {
        "empty": b"",
        "text": b"no image",
        "png": whole[".png"][:-30],
        "jpeg": whole[".jpg"][: len(whole[".jpg"]) // 2],
        "bmp": whole[".bmp"][:-500],
        "tiff": whole[".tiff"][:60],
        "header": b"\x89PNG\r\n\x1a\n" + bytes(40) + b"IEND\xaeB`\x82",
    }[how]
    (folder / "broken").write_bytes(content)
    return folder / "broken"


@pytest.mark.parametrize(
    ("how", "words"),
    [
        ("empty", "an empty file; copy it again"),
        ("text", "cannot decode; save it as PNG"),
        ("png", "PNG image, found one that breaks off"),
        ("jpeg", "JPEG image, found one that breaks off"),
        ("bmp", "BMP image, found one that breaks off"),
        ("tiff", "cannot decode"),
        ("header", "cannot decode"),
    ],
)
def test_broken_file_gets_its_sentence(tmp_path, how, words):
    with pytest.raises(InputError) as caught:
        images.read(broken(tmp_path, how), "cell-4/images/a.png")
    sentence = str(caught.value)
    assert sentence.startswith("cell-4/images/a.png: expected ") and ", found " in sentence
    assert words in sentence and "\n" not in sentence and str(tmp_path) not in sentence


def test_missing_file_and_float_pixels_get_theirs(tmp_path):
    with pytest.raises(InputError, match="found none to read"):
        images.read(tmp_path / "nowhere.png", "a.png")
    with pytest.raises(InputError, match="8 or 16 bits a pixel, found float32"):
        images.read(saved(tmp_path, "f.tiff", SCENE.astype(np.float32)), "f.tiff")
    with pytest.raises(InputError, match="expected one of grey, blue, green, red, found 'cyan'"):
        images.read(
            saved(tmp_path, "a.png", np.dstack([SCENE] * 3 + [SCENE])), "a.png", channel="cyan"
        )


def grainy(level, sigma, shape=(120, 160)):
    return np.clip(
        np.rint(level + sigma * np.random.default_rng(1).standard_normal(shape)), 0, 255
    ).astype(np.uint8)


@pytest.mark.parametrize(
    ("image", "why"),
    [
        (np.zeros((50, 60), np.uint8), "all black"),
        (grainy(1, 0.6), "all black"),
        (np.full((50, 60), 255, np.uint8), "saturated"),
        (
            np.where(np.arange(6000).reshape(60, 100) % 100 < 60, 255, 30).astype(np.uint8),
            "saturated: 60 % of the pixels",
        ),
        (np.full((50, 60), 90, np.uint8), "no contrast: grey values from 90 to 90 of 255"),
        (grainy(120, 25), "no contrast"),
        (np.zeros((50, 60), np.uint16), "all black"),
    ],
)
def test_useless_image_is_rejected_by_name(image, why):
    assert images.flaw(image).startswith(why)


@pytest.mark.parametrize(
    "image",
    [SCENE, grainy(SCENE, 4, SCENE.shape), np.where(SCENE > 160, 255, 40).astype(np.uint8)],
)
def test_useful_image_is_not(image):
    assert images.flaw(image) is None


@pytest.mark.parametrize("sigma", [1.0, 3.0, 10.0])
def test_noise_is_measured_away_from_edges(sigma):
    """Whole counts alone leave a third of one open."""
    scene = np.where(np.add.outer(np.arange(200), np.arange(300)) // 25 % 2, 180, 70)
    assert images.noise(grainy(scene, sigma, scene.shape)) == pytest.approx(
        sigma, rel=0.12, abs=0.34
    )


def test_odd_size_among_its_fellows_is_named():
    odd = images.odd_sizes([(640, 480), (640, 480), (480, 640), (640, 480)])
    assert odd == {2: "wrong size: 480 x 640 px among images of 640 x 480 px"}
    assert images.odd_sizes([(640, 480)] * 3) == {} == images.odd_sizes([])


def test_stacks_hold_a_few_images_at_a_time(tmp_path, monkeypatch):
    """Ten images in stacks of four: never more than four are read ahead of what was handed on."""
    paths = [saved(tmp_path, f"{k}.png", SCENE + k) for k in range(10)]
    read = []
    whole = images.read_grey
    monkeypatch.setattr(
        images, "read_grey", lambda path, *more: read.append(path) or whole(path, *more)
    )
    handed = 0
    for stack in images.stacks(paths, frames=4):
        assert len(read) <= handed + 4
        np.testing.assert_array_equal(
            stack, [SCENE + k for k in range(handed, handed + len(stack))]
        )
        handed += len(stack)
    assert handed == 10


def test_stack_of_two_sizes_gets_its_sentence(tmp_path):
    paths = [saved(tmp_path, "a.png", SCENE), saved(tmp_path, "b.png", SCENE.T)]
    with pytest.raises(
        InputError, match="b.png: expected 60 x 40 px as in the images before, found 40 x 60 px"
    ):
        list(images.stacks(paths, called=lambda path: path.name))


def test_eight_bits_for_finders_span_the_image():
    deep = (SCENE.astype(np.uint16) + 100) * 10
    made = images.to_eight_bits(deep)
    assert made.dtype == np.uint8 and made.min() == 0 and made.max() == 255
    assert np.corrcoef(made.ravel(), deep.ravel())[0, 1] > 0.999
