"""
Optics: blur and glare
======================

Motion, defocus, diffraction and blooming spread the light of an LED. Glare adds light everywhere.
"""

import matplotlib.pyplot as plt

import vocc_torch as vt

BASE = {"saturation": {}, "quantization": {}}
EFFECTS = {
    "motion_blur": {"motion_blur": {"velocity_x_m_s": 60}},
    "defocus": {"defocus": {"focus_distance_m": 0.6}},
    "diffraction": {"diffraction": {}},
    "blooming": {"blooming": {"sigma_px": 2}},
    "veiling_glare": {"veiling_glare": {"luminance_cd_m2": 1500}},
}

plt.figure(figsize=(9, 2.6), layout="constrained")
for number, (title, effects) in enumerate(EFFECTS.items(), 1):
    settings = {"distance_m": 20, "ambient_lx": 3000, "effects": BASE | effects}
    batch = next(vt.simulate(vt.load_scene(settings, "camera.f_number=32"), frames=1))
    plt.subplot(1, len(EFFECTS), number, title=title)
    plt.imshow(batch.frames.grey[0, 0], cmap="gray", vmin=0, vmax=255)
plt.show()
