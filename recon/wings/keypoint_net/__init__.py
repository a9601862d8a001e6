"""A small keypoint network: trained on a few labels, it turns a video into a keypoint file.

It needs torch (extra `net`), which is imported where it is used.
"""

from typing import TYPE_CHECKING

from recon.base import lazily

if TYPE_CHECKING:
    from recon.wings.keypoint_net.evaluate2d import evaluate_2d_files
    from recon.wings.keypoint_net.labels import read_label_file, read_labels
    from recon.wings.keypoint_net.network import FORMAT, load_model, load_torch, model_file
    from recon.wings.keypoint_net.train import TrainSettings
    from recon.wings.keypoint_net.workflows import LabelSource, PredictSettings, run_prediction, run_training

__getattr__ = lazily(__name__, __file__)
