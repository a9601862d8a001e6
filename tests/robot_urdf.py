"""Write a URDF file with the legs of the built-in robot a1, joint by joint, and feet on fixed joints."""

HEAD = '<?xml version="1.0"?>\n<robot name="a1">\n<link name="base"/>\n<link name="trunk"/>\n' + (
    '<joint name="floating_base" type="fixed"><parent link="base"/><child link="trunk"/></joint>\n'
)
JOINT = """<link name="{child}"/>
<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/><origin xyz="{xyz}" rpy="{rpy}"/>
{rest}</joint>
"""


def moving(axis, lower, upper):
    return f'<axis xyz="{axis}"/><limit lower="{lower}" upper="{upper}" effort="33.5" velocity="21.0"/>'


def a1_urdf():
    out = HEAD
    for label, x, y in (("FL", 1, 1), ("FR", 1, -1), ("RL", -1, 1), ("RR", -1, -1)):
        hip, thigh, calf, foot = (f"{label}_{part}" for part in ("hip", "thigh", "calf", "foot"))
        for name, kind, parent, child, xyz, rest in (
            (
                f"{hip}_joint",
                "revolute",
                "trunk",
                hip,
                f"{0.1805 * x} {0.047 * y} 0",
                moving("1 0 0", -0.80285, 0.80285),
            ),
            (f"{thigh}_joint", "revolute", hip, thigh, f"0 {0.0838 * y} 0", moving("0 1 0", -1.0472, 4.18879)),
            (f"{calf}_joint", "revolute", thigh, calf, "0 0 -0.2", moving("0 1 0", -2.69653, -0.9163)),
            (f"{foot}_fixed", "fixed", calf, foot, "0 0 -0.2", ""),
        ):
            out += JOINT.format(name=name, kind=kind, parent=parent, child=child, xyz=xyz, rpy="0 0 0", rest=rest)
    return out + "</robot>\n"
