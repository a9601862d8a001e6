"""Get from a video and some labelled frames to 3D: train a small network, predict keypoints, and fit the motion.

Run it with `python video_to_3d.py`, which needs `pip install '.[net]'`. Its inputs and outputs are set in
video_to_3d.toml.
"""

import tomllib
from pathlib import Path

import recon

FILE = Path(__file__).with_suffix(".toml")
config = tomllib.loads(FILE.read_text(encoding="utf-8"))
results, video, model = (FILE.parent / config[name] for name in ("results", "video", "model"))
labels = FILE.parent / config["labels"]["labels"]

# Train a network on the labels, unless the folder already has one.
if not (model / "model.pt").is_file():
    source = recon.LabelSource(data=video, labels=labels, first_frame=config["labels"]["first_frame"])
    training = recon.run_training(source, recon.TrainSettings(**config["training"]), model)
    print(f"Errors by keypoint, and labels that are probably wrong: {model}")

# Predict the keypoints of every frame, and draw them on the video.
keypoints = recon.run_prediction(
    video, model, results / "keypoints.csv", overlay=results / "keypoints.mp4", overwrite=True
)
likely = (keypoints.confidence > 0.5).mean()
print(f"{len(keypoints.frames)} frames, {likely:.0%} of their points with a high likelihood")

# Fit the 3D motion.
settings = recon.read_settings(FILE, {"keypoints": results / "keypoints.csv"})
motion = recon.fit_clip(settings)
report = recon.write_clip(motion, settings, results / "motion")
summary = report["summary"]
print(f"{summary['frames_with_pose']} of {summary['frames']} frames have a pose, {summary['frames_flagged']} flagged")
for finding in report["findings"]:
    if finding["severity"] != "note":
        print(finding["text"])

print(f"Results are in {results / 'motion'}. Watch them with: recon view {results / 'motion'}")
