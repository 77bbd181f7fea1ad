from setuptools import setup

NAME = "microbot_ocp_ros"
setup(
    name=NAME,
    version="0.1.0",
    packages=[NAME],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
    ],
    install_requires=["setuptools", "microbot_ocp"],
    entry_points={"console_scripts": [f"services = {NAME}.node:main"]},
)
