import pytest
import torch

from lerobot_act_chunking.nn.image_view import ImageView, resize

B, H, SIZE, PART = 3, 2, (9, 14), (4, 5)


def numbered():
    """Images whose pixels say where they are."""
    rows, columns = torch.meshgrid(torch.arange(SIZE[0]), torch.arange(SIZE[1]), indexing="ij")
    image = torch.stack((rows, columns, rows * 0)).float()
    return image.expand(B, H, 3, *SIZE) + 100 * torch.arange(B)[:, None, None, None, None]


def corners(crops):
    """Row and column of each crop's first pixel, without the sample's number."""
    return crops[:, :, :2, 0, 0] - 100 * torch.arange(B)[:, None, None]


def test_without_settings_images_are_handed_through():
    images, view = numbered(), ImageView()
    assert view(images, torch.Generator().manual_seed(0)) is images
    assert view.seen_shape((3, 9, 14)) == view.resized_shape((3, 9, 14)) == (3, 9, 14)


def test_images_of_the_right_size_are_not_resized():
    images = numbered()
    assert resize(images, SIZE) is images


def test_all_cameras_get_one_size_with_and_without_a_time_axis():
    view = ImageView(resize_shape=(6, 8), crop_shape=PART)
    for lead in ((B,), (B, H)):
        assert view(torch.rand(*lead, 3, 31, 17)).shape == (*lead, 3, *PART)
    assert view.resized_shape((3, 31, 17)) == (3, 6, 8)
    assert view.seen_shape((3, 31, 17)) == (3, *PART)


def test_bytes_are_resized_as_numbers_are():
    images = torch.randint(0, 256, (B, 3, 48, 64), generator=torch.Generator().manual_seed(0)).byte()
    as_bytes, as_numbers = resize(images, (24, 32)), resize(images.float(), (24, 32))
    assert as_bytes.dtype == torch.uint8
    assert (as_bytes.float() - as_numbers).abs().max() <= 1


def test_random_parts_belong_to_one_sample_and_reach_every_border():
    images, generator = numbered(), torch.Generator().manual_seed(0)
    seen = set()
    for _ in range(200):
        crops = ImageView(crop_shape=PART)(images, generator)
        first = corners(crops)
        assert torch.equal(first[:, 0], first[:, 1])  # all steps of a sample alike
        rows = crops[:, :, 0] - crops[:, :, 0, :1, :1]
        assert torch.equal(rows, torch.arange(4.0)[:, None].expand_as(rows))
        seen |= {tuple(each) for each in first[:, 0].long().tolist()}
    assert seen == {(row, column) for row in range(6) for column in range(10)}


def test_the_same_seed_draws_the_same_parts():
    view = ImageView(crop_shape=PART)
    first, second, other = (view(numbered(), torch.Generator().manual_seed(seed)) for seed in (1, 1, 2))
    assert torch.equal(first, second)
    assert not torch.equal(first, other)


@pytest.mark.parametrize("size", [SIZE, (1, 1), (9, 3)])
def test_without_a_generator_the_middle_is_seen(size):
    crops = ImageView(crop_shape=size)(numbered())
    expected = torch.tensor([round((whole - part) / 2) for whole, part in zip(SIZE, size, strict=True)])
    assert torch.equal(corners(crops), expected.float().expand(B, H, 2))
