"""Prints the reference scores of tests/tests/stanford_orb.rs, by the benchmark's own functions.

    git clone https://github.com/StanfordORB/Stanford-ORB
    pip install numpy opencv-python-headless imageio torch kornia
    python tests/scripts/stanford_orb_reference.py Stanford-ORB

The pictures are those that the test makes, by integers only. PSNR is the benchmark's `calc_PSNR`, called as its `compute_similarity`
does; SSIM is kornia's, as its `ssim` calls it, on the processor instead of a graphics card. Its `test.py` itself is not imported, which
wants LPIPS, a mesh library and CUDA. A line a view and scale: PSNR-H, PSNR-L, SSIM.
"""

import sys

import numpy as np

BENCHMARK = sys.argv[1] if len(sys.argv) == 2 else sys.exit(__doc__)
sys.path.insert(0, BENCHMARK)

import torch
from kornia.losses import ssim_loss
from orb.utils.metrics import calc_PSNR, erode_mask
from orb.utils.preprocess import cv2_downsize


def picture(side, value):
    """A picture of `side`² pixels and three channels, as `picture` of the test makes it."""
    y, x, c = np.meshgrid(*(np.arange(n, dtype=np.int64) for n in (side, side, 3)), indexing="ij")
    return value(x, y, c).astype(np.float32)


def photograph(view):
    def value(x, y, c):
        ramp = (x * (c + 1) + y * (3 - c) + 97 * view) % 2048
        noise = (x * 37 + y * 17 + x * y * (c + 3) + 11 * view) % 251
        light = ramp / 1024 + noise / 1000
        return np.where((x // 64 + y // 64) % 7 == 0, 5 * light, light)

    return picture(1024, value)


def mask(view):
    disc = picture(1024, lambda x, y, c: (x - 500 - 20 * view) ** 2 + (y - 520) ** 2 < 400**2)
    return disc[..., 0]


def prediction(view):
    def value(x, y, c):
        ramp = (2 * x * (c + 1) + 2 * y * (3 - c) + 97 * view) % 2048
        noise = (x * 53 + y * 29 + x * y * (c + 1)) % 127
        light = (0.5 + 0.2 * c) * (ramp / 1024 + noise / 400)
        return np.where((view == 1) & (c == 2), 0, light)

    return picture(512, value)


def scores(view, scale):
    # The benchmark's photographs have 2048 pixels a side and are reduced by 4; these have 1024.
    truth, inside = (cv2_downsize(image, 2) for image in (photograph(view), mask(view)))
    inside = (inside > 0.5).astype(np.float32)

    def psnr(**how):
        return calc_PSNR(prediction(view), truth.copy(), inside, divide_mask=False, scale_invariant=scale, **how)

    high, _, _ = psnr(max_value=4, use_gt_median=True, tonemapping=False)
    low, shown, truth_shown = psnr(max_value=1, use_gt_median=False, tonemapping=True)
    eroded = erode_mask(inside, None)[:, :, None]
    tensors = [
        torch.tensor(image * eroded, dtype=torch.float32).permute(2, 0, 1).unsqueeze(0)
        for image in (shown, truth_shown)
    ]
    return high, low, 1 - 2 * ssim_loss(*tensors, 3).item()


for scale in (True, False):
    for view in (0, 1):
        print("Best" if scale else "None", view, *(f"{score:.7f}" for score in scores(view, scale)))
