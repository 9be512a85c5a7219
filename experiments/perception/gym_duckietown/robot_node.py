"""Drives a robot by `pose.onnx`, without our package: pictures in, lane poses and wheel commands out.

`python robot_node.py pose.onnx 0` prints both for each picture of camera 0, or of a film of that name. With `ros`
instead of 0, a node of ROS 2 reads `image/compressed`, and writes `lane` and `wheels`. Pictures are those of the camera
in the file's metadata. Lane poses are metres and radians to the left, and 1 / metres. Commands are -1 to 1, left first.
"""

import json
import sys

import cv2
import numpy as np
import onnxruntime

SPEED, LOOKAHEAD, SLOWING = 0.25, 0.2, 0.2  # metres a second, metres, metres
FORWARD, TURN = 0.3, 3.75  # of your robot: metres and radians a second, at a sum and a difference of 1


class Pilot:
    def __init__(self, file: str) -> None:
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1  # more threads wait busily
        self.session = onnxruntime.InferenceSession(file, options, providers=["CPUExecutionProvider"])
        self.tile = json.loads(self.session.get_modelmeta().custom_metadata_map["tile_metres"])

    def __call__(self, image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:  # RGB, 4 : 3
        small = cv2.resize(image, (160, 120), interpolation=cv2.INTER_AREA)
        lane = self.session.run(None, {"image": small[None]})[0][0] * np.array([self.tile, 1, 1 / self.tile])
        d, phi, half = lane * (1, 1, LOOKAHEAD / 2)  # pure pursuit of the point LOOKAHEAD further on the lane's arc
        ahead, beside = LOOKAHEAD * np.sinc(half / np.pi) * np.array([np.cos(half), np.sin(half)]) - (0, d)
        bend = 2 * (beside * np.cos(phi) - ahead * np.sin(phi)) / (ahead**2 + beside**2)
        speed = SPEED / (1 + SLOWING * abs(bend))
        return lane, np.clip(speed / 2 * (1 / FORWARD + np.array([-1, 1]) * bend / TURN), -1, 1)


def watch(pilot: Pilot, source: str) -> None:
    film = cv2.VideoCapture(int(source) if source.isdigit() else source)
    while (read := film.read())[0]:
        print(*(values.round(4) for values in pilot(read[1][..., ::-1])), flush=True)


def spin(pilot: Pilot, _: str) -> None:
    import rclpy
    from sensor_msgs.msg import CompressedImage
    from std_msgs.msg import Float32MultiArray

    def see(message: CompressedImage) -> None:
        image = cv2.imdecode(np.frombuffer(message.data, np.uint8), cv2.IMREAD_COLOR)
        for topic, values in zip(topics, () if image is None else pilot(image[..., ::-1]), strict=False):
            topic.publish(Float32MultiArray(data=values.tolist()))

    rclpy.init()
    node = rclpy.create_node("lane_pilot")
    topics = [node.create_publisher(Float32MultiArray, name, 1) for name in ("lane", "wheels")]
    node.create_subscription(CompressedImage, "image/compressed", see, 1)
    rclpy.spin(node)


if __name__ == "__main__":
    (spin if sys.argv[2] == "ros" else watch)(Pilot(sys.argv[1]), sys.argv[2])
