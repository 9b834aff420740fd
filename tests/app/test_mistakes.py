"""Every mistake on the command line is said in one line that names the key; found before any work is done."""

import pytest
import torch
from composing import complaint_of, composed, study_of

MISTAKES = [
    # Each: the words of a command line, and parts of its complaint.
    ("experiment=ambeint", "experiment is 'ambeint'", "ambient, classifiers, contrast, dimming, distance"),
    ("task=tset", "task is 'tset'", "classifiers, collect, decode, effects, figures, test, tradeoff, train"),
    ("task=tradeoff tradeoff.devices=[tpu]", "tradeoff.devices has 'tpu'", "auto, cpu or cuda"),
    ("task=tradeoff tradeoff.devices=[cuda:77]", "tradeoff.devices has 'cuda:77'", "this machine has"),
    (
        "task=tradeoff +tradeoff.scenes.odd={distance:5}",
        "tradeoff.scenes.odd.distance",
        "not a value of a scene",
    ),
    ("task=tradeoff +tradeoff.scenes.odd=5", "tradeoff.scenes.odd is 5: it must be"),
    ("task=tradeoff budget.precision=0.1", "budget.precision is 0.1", "must be null for task=tradeoff"),
    ("classifier=[lmmse,mpl]", "classifier has 'mpl'", "it must be of boosted_trees, cnn, ", "lmmse"),
    ("scene=moon", "scene is 'moon'", "paper"),
    ("sede=1", "sede is not a known key", "did you mean seed?"),
    ("camera.gama=2", "camera.gama", "did you mean camera.gamma?"),
    ("zzz=1", "zzz is not a known key", "--help"),
    ("+foo=1", "foo is not a known key"),
    ("++foo=1", "foo is not a known key"),
    ("+camera.gama=2", "camera.gama", "did you mean camera.gamma?"),
    ("+scene.distance=5", "scene.distance ", "did you mean scene.distance_m?"),
    ("~seed", "seed is missing"),
    ("~scene.distance_m", "scene.distance_m cannot be removed"),
    ("~scene.effects.fog", "scene.effects.fog is not set"),
    ("~experiment", "experiment is missing"),
    ("+experiment=distance", "experiment is chosen twice"),
    ("scene=null", "scene is null", "--help"),
    ("panel.rows=null", "panel.rows is null"),
    ("scene.distance_m=-5", "scene.distance_m is -5", "above 0"),
    ("experiment.scene.distance_m=[uniform,-5,5]", "experiment.scene.distance_m is -5", "above 0"),
    ("+experiment.training.distance_m=-5", "experiment.training.distance_m is -5", "above 0"),
    ("experiment.values=[-5,5]", "experiment.values has -5", "at least 0"),
    (
        "experiment.axis=background_grey experiment.values=[100,300]",
        "experiment.values has 300",
        "at most 255",
    ),
    ("scene.ambient_lx=[uniform,1]", "scene.ambient_lx is", "[uniform, low, high]"),
    ("scene.ambient_lx=[uniform,5,1]", "scene.ambient_lx", "low must not exceed"),
    ("experiment.scene.distance_m=near", "experiment.scene.distance_m is 'near'", "[uniform, low, high]"),
    ("+experiment.scene.fog=1", "experiment.scene.fog is not a value of a scene", "ambient_lx"),
    ("experiment.scene.background_grey=1", "+experiment.scene.background_grey="),
    ("scene.effects.blooming.sigma_px=-1", "scene.effects.blooming.sigma_px is -1", "above 0"),
    ("+scene.effects.blomming.sigma_px=1", "scene.effects.blomming", "did you mean blooming?"),
    ("+scene.effects.blooming.sigma=1", "scene.effects.blooming.sigma", "sigma_px"),
    ("~scene.effects.blooming.sigma_px", "scene.effects.blooming.sigma_px is missing"),
    ("scene.effects.blooming=null", "scene.effects.blooming is null", "~scene.effects.blooming"),
    ("scene.effects.blooming=2", "scene.effects.blooming is 2", "mapping"),
    ("scene.effects=2", "scene.effects is '2'", "mapping"),
    ("~scene.effects.saturation", "scene.effects.quantization", "saturation"),
    ("budget.frames=0", "budget.frames is 0", "at least 1"),
    ("budget.training_frames=1", "budget.training_frames is 1", "at least 2"),
    ("budget.target_frame_errors=0", "budget.target_frame_errors is 0", "at least 1"),
    ("panel.rows=0", "panel.rows is 0", "at least 1"),
    ("panel.led_gap_m=-1", "panel.led_gap_m is -1", "at least 0"),
    ("budget.frames=many", "budget.frames is 'many'", "a whole number"),
    ("panel.rows=1.5", "panel.rows is '1.5'", "a whole number"),
    ("camera.gamma=bright", "camera.gamma is 'bright'", "a number"),
    ("camera.gamma=[1]", "camera.gamma is '[1]'", "a number"),
    ("tensorboard=maybe", "tensorboard is 'maybe'", "true or false"),
    ("camera.iso_limits=100", "camera.iso_limits is '100'", "a list"),
    ("receiver.names=flda_3", "receiver.names is 'flda_3'", "a list"),
    ("experiment.values=[low]", "experiment.values[0] is 'low'", "a number"),
    ("input=[a,b]", "input is '[a,b]'", "text"),
    ("camera=[1,2]", "camera is [1,2]", "one of the options"),
    ("experiment.values=${seed}", "experiment.values is 0", "a list"),
    ("~scene.effects.blooming=0", "not 0", "write ~scene.effects.blooming"),
    ("camera.gamma=nan", "camera.gamma is nan", "at least 0.1"),
    ("camera.iso_limits=[1]", "camera.iso_limits is [1.0]", "[low, high]"),
    ("camera.iso_limits=[200,100]", "camera.iso_limits is [200.0, 100.0]", "low <= high"),
    (
        "experiment=contrast experiment.values=[-1,0,0.4]",
        "experiment.values has -1",
        "contrast",
        "at least 0",
    ),
    ("experiment.values=[2,1]", "experiment.values is [2.0, 1.0]", "ascending"),
    ("experiment.values=[]", "experiment.values is []", "at least 1"),
    ("experiment=contrast experiment.values=[0.1]", "experiment.values is [0.1]", "at least 2"),
    ("experiment.axis=fog", "experiment.axis is 'fog'", "ambient_lx"),
    ("experiment.name=train", "experiment.name is 'train'"),
    ("receiver.names=[flda_9]", "receiver.names has 'flda_9'", "flda_3"),
    ("receiver.names=[flda_3,flda_3]", "receiver.names is ['flda_3', 'flda_3']", "once"),
    ("receiver.locator=guess", "receiver.locator is 'guess'", "truth or paper"),
    ("receiver.save=center_greyscale", "receiver.save is 'center_greyscale'", "flda_3"),
    ("receiver.location.closing_px=2", "receiver.location.closing_px is 2", "odd"),
    ("receiver.gradient=steep", "receiver.gradient is 'steep'", "sobel or central"),
    ("seed=-1", "seed is -1", "at least 0"),
    ("batch_frames=0", "batch_frames is 0", "at least 1"),
    ("precision=float16", "precision is 'float16'", "float32 or float64"),
    ("framing=wide", "framing is 'wide'", "crop"),
    ("device=abacus", "device is 'abacus'", "auto, cpu or cuda"),
    ("device=meta", "device is 'meta'", "auto, cpu or cuda"),
    ("name=", "name is ''", "below runs/"),
    ("name=../away", "name is '../away'", "below runs/"),
    ("name=${nothing}", "nothing", "known key"),
    (
        "task=decode decode.channel=infrared",
        "decode.channel is 'infrared'",
        "one of luma, max, red, green, blue",
    ),
    ("task=decode input=no.png decode.scale=0", "decode.scale is 0", "from 1 to 16"),
    ("seed", "seed cannot be read", "key=value"),
    ("experiment.values=[1", "experiment.values=[1 cannot be read"),
    ("name=${seed", "name=${seed cannot be read"),
    ("seed=1,2", "seed is 1,2", "-m"),
    ("task=decode receiver.locator=truth", "receiver.locator is 'truth'", "paper or refined for task=decode"),
    ("receiver=rivals task=decode", "receiver.locator is 'truth'", "a recording does not tell its corners"),
    ("device=cpu:7", "device is 'cpu:7'", "auto, cpu or cuda"),
    ("experiment.rows=[1,2]", "experiment.row_axis is None", "led_luminance_cd_m2"),
    ("experiment=dimming experiment.rows=[2,1]", "experiment.rows is [2.0, 1.0]", "ascending"),
    ("experiment=dimming experiment.rows=[0,1]", "experiment.rows has 0", "above 0"),
    ("experiment=dimming experiment.row_axis=led_luminance_cd_m2", "experiment.row_axis is 'led_lum"),
    # Sections replaced by what is no section.
    ("decode=${seed}", "decode", "a mapping"),
    ("scene.camera=${panel}", "scene.camera.rows is not a known key"),
    ("panel=${seed}", "panel is ${seed}", "one of the options"),
    ("receiver.names=${seed}", "receiver.names is 0", "a list"),
    ("experiment.values=${receiver.names}", "experiment.values[0] is 'center_greyscale'", "a number"),
    ("seed=${camera}", "seed", "a whole number"),
    # Scenes.
    ("scene=night +scene.effects.shot_nois={}", "did you mean shot_noise?"),
    ("scene=night +scene.effects.full_well.electron=1", "did you mean electrons?"),
    ("scene=night scene.effects.photoelectrons.quantum_efficiency=1.2", "at most 1"),
    ("scene=night ~scene.effects.photoelectrons", "which scene.effects.photoelectrons makes"),
    ("scene=night ~scene.effects.gain", "which scene.effects.gain makes"),
    ("scene=night scene.effects.shot_noise=null", "~scene.effects.shot_noise"),
    ("scene=night +scene.camera.lens=1", "scene.camera.lens"),
    ("scene=night scene.camera.f_number=0", "scene.camera.f_number is 0: it must be above 0"),
    ("scene=night +scene.effects.pose={yaw_deg:[normal,0,1]}", "effects.pose.yaw_deg is"),
    ("scene=night +scene.effects.pose={yaw_deg:100}", "scene.effects.pose.yaw_deg"),
    ("scene=night +scene.effects={jpeg:{quality:80},quantization:{bits:10}}", "jpeg codes 8-bit"),
    # What would be passed over.
    (
        "scene=dashcam camera.focal_length_mm=18",
        "camera.focal_length_mm is set by the scene dashcam: give scene.camera.focal_length_mm=18",
    ),
    ("scene.effects={}", "scene.effects={} takes none away"),
    ("scene=[night,fog]", "scene is [night,fog]: it must be one option"),
    ("decode.scale=2", "decode.scale is 2: only task=decode uses it, and the task is test"),
    ("task=train rivals.genie_frames=3", "rivals.genie_frames is 3: only task=classifiers uses it"),
    ("task=decode model=r.pt receiver.locator=paper", "receiver.locator is paper: the model brings its own"),
    ("task=decode model=r.pt receiver.samples_per_led=4", "receiver.samples_per_led is 4: the model brings"),
    ("task=decode model=r.pt panel.led_gap_m=0.1", "panel.led_gap_m is 0.1: the model brings its own"),
    ("task=decode model=r.pt classifier=lmmse", "classifier is lmmse: the model brings its own"),
    # Names that become names of files.
    ("name=x experiment.name=../../x", "experiment.name is '../../x'", "a word of letters, digits"),
    ("name=x experiment.name=a/b", "experiment.name is 'a/b'", "a word"),
    ("+classifiers={_summary:{build:{_target_:x.Y}}}", "classifiers._summary", "none of", "flda_3"),
    ("+classifiers={flda_3:{build:{_target_:x.Y}}}", "classifiers.flda_3", "must be a word"),
    ("+classifiers={../x:{build:{_target_:x.Y}}}", "classifiers.../x: a classifier's name must be a word"),
    (
        "task=figures +figures.experiments={../../x:{name:x,axis:distance_m,values:[1]}}",
        "figures.experiments is '../../x'",
        "a word",
    ),
    (
        "task=classifiers +rivals.experiments={a/b:{name:x,axis:distance_m,values:[1]}}",
        "rivals.experiments is 'a/b'",
        "a word",
    ),
    # A refusal names the section that the user wrote.
    (
        "task=figures figures.experiments.distance.values=[2,1]",
        "figures.experiments.distance.values is [2.0, 1.0]",
    ),
    ("task=classifiers rivals.experiments.ambient.values=[-1]", "rivals.experiments.ambient.values has -1"),
    ("task=classifiers rivals.scenes.fog.distance_m=-3", "rivals.scenes.fog.distance_m is -3", "above 0"),
    (
        "task=figures figures.experiments.ambient.scene.distance_m=-3",
        "figures.experiments.ambient.scene.distance_m is",
    ),
    ("classifier=lmmse +classifiers.lmmse.inputs.patch.colour=1", "classifiers.lmmse.inputs.patch.colour"),
    ("classifier=mlp +classifiers.mlp.training.epoch=1", "classifiers.mlp.training.epoch", "epochs"),
    (
        "classifier=mlp classifiers.mlp.training.epochs=0",
        "classifiers.mlp.training.epochs is 0",
        "at least 1",
    ),
    ("classifier=cnn classifiers.cnn.scene.ambient_lx=dark", "classifiers.cnn.scene.ambient_lx is 'dark'"),
    ("classifier=sklearn", "classifiers.sklearn.build._target_"),
]


@pytest.mark.parametrize(("words", "parts"), [(words, parts) for words, *parts in MISTAKES])
def test_a_mistake_is_one_line_that_names_the_key(words, parts):
    said = complaint_of(*words.split())
    for part in parts:
        assert part in said


@pytest.mark.skipif(torch.cuda.is_available(), reason="this machine has CUDA: device=cuda is no mistake here")
@pytest.mark.parametrize("device", ["cuda", "cuda:1"])
def test_a_device_that_is_not_there(device):
    said = complaint_of(f"device={device}")
    assert f"device is '{device}'" in said
    assert "device=cpu or device=auto" in said


def test_what_a_model_must_agree_with_may_be_said():
    assert composed("task=decode", "model=r.pt", "panel.rows=4", "decode.scale=2").panel.rows == 4


def test_the_scene_changes_the_camera_and_the_experiment_the_scene():
    plan = study_of("scene=dashcam", "camera.gamma=2", "experiment.scene.distance_m=33")
    assert plan.world.camera.gamma == 2
    assert plan.world.camera.focal_length_mm != 25
    assert plan.experiment.scene["distance_m"].bounds == (33, 33)
    assert plan.experiment.model_at(plan.world, 4000.0).ambient_lx.bounds == (4000, 4000)
