"""A small keypoint network: trained on a few labels, it turns a video into a keypoint file.

It needs torch (extra `net`), which is imported where it is used.
"""

from typing import TYPE_CHECKING

from recon.base import lazily

if TYPE_CHECKING:
    from recon.keypoint_net.labels import LabelSource, evaluate_2d_files, read_label_file, read_labels
    from recon.keypoint_net.network import FORMAT, PredictSettings, load_model, model_file, run_prediction
    from recon.keypoint_net.train import TrainSettings, run_training

__getattr__ = lazily(__name__, __file__)
