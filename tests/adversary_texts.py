"""Drawings, robots and scenes as nobody means them (tests/adversary_foreign.py): each function
takes the valid text, and gives others by kind."""

from __future__ import annotations

import itertools
import re

_ENTITY = '<!DOCTYPE r [<!ENTITY x SYSTEM "file:///etc/passwd">]>'
_REMOTE = '<!DOCTYPE r SYSTEM "http://127.0.0.1:9/x.dtd">'


def svg(text: str) -> dict[str, str]:
    """Of a drawing with one path."""

    def path(d: str, more: str = "") -> str:
        return re.sub(r' d="[^"]*"', f' d="{d}" {more}', text)

    def inside(content: str) -> str:
        return text.replace("</svg>", content + "</svg>")

    def root(words: str) -> str:
        return re.sub(r'viewBox="[^"]*"', words, text)

    line = "M 10 50 L 190 50"
    use = '<use xlink:href="#{}" xmlns:xlink="http://www.w3.org/1999/xlink"/>'
    return {
        "an entity": _ENTITY + inside("<text>&x;</text>"),
        "remote": _REMOTE + text,
        "uses itself": inside(f'<g id="a">{use.format("a")}</g>'),
        "use each other": inside(
            f'<g id="a">{use.format("b")}</g><g id="b">{use.format("a")}</g>{use.format("a")}'
        ),
        "many uses": inside(
            '<g id="u0"/>'
            + "".join(f'<g id="u{k}">{use.format(f"u{k - 1}") * 10}</g>' for k in range(1, 9))
        ),
        "no path": path(""),
        "M alone": path("M 1 1"),
        "two rods": path(f"{line} M 10 90 L 190 90"),
        "nan": path("M nan nan L 1 1"),
        "1e308": path("M 0 0 L 1e308 1e308 C 1e308 0 0 1e308 1 1"),
        "no radius": path("M 10 50 A 0 0 0 0 1 100 50"),
        "tiny radius": path("M 10 50 A 1e-9 1e-9 0 0 1 100 50"),
        "closed": path("M 10 50 L 90 50 L 90 90 Z"),
        "there and back": path(f"{line} L 10 50"),
        "a loop": path("M 10 50 C 300 90 -100 90 190 50"),
        "corners": path("M 10 50" + "".join(f" l 2 {9 * (-1) ** k}" for k in range(40))),
        "words": path("hello world"),
        "no M": path("L 10 10 L 50 50"),
        "cut off": path("M 10 50 C 1"),
        "100 000 steps": path("M 10 50" + " l 0.001 0.001" * 100_000),
        "commas": path("M10,50,L190,50,"),
        "flags together": path("M10 50a25 25 0 01100 0"),
        "deep": inside("<g>" * 900 + "</g>" * 900),
        "turned": path(line, 'transform="rotate(nan)"'),
        "flat": path(line, 'transform="scale(0)"'),
        "sheared": path(line, 'transform="matrix(1 1 1 1 0 0)"'),
        "hidden": path(line, 'style="display:none"'),
        "a script": inside("<script>alert(1)</script>"),
        "large style": inside(f"<style>{'a{}' * 50_000}</style>"),
        "dashes": path(line, 'stroke-dasharray="0"'),
        "box of 0": root('viewBox="0 0 0 0"'),
        "box of words": root('viewBox="a b c d"'),
        "box below": root('viewBox="0 0 -200 -100"'),
        "box of nan": root('viewBox="0 0 nan nan"'),
        "no box": root(""),
        "per cent": text.replace("200mm", "100%"),
        "em": text.replace("200mm", "20em"),
        "no size": re.sub(r'(width|height)="[^"]*mm"', "", text),
        "unequal": text.replace('height="100mm"', 'height="700mm"'),
        "size 0": text.replace("200mm", "0mm"),
        "size below": text.replace("200mm", "-200mm"),
        "a picture": inside('<image href="data:image/png;base64,AAAA" width="9" height="9"/>'),
        "a circle": text.replace("<path", '<circle r="20" cx="50" cy="50"/><path', 1),
        "text only": re.sub(r"<path[^>]*/>", '<text x="1" y="9">A</text>', text),
        "namespace": text.replace("<", "<s:").replace("<s:/", "</s:").replace("xmlns=", "xmlns:s="),
        "no namespace": text.replace('xmlns="http://www.w3.org/2000/svg"', ""),
        "Inkscape": text.replace("<path", '<path sodipodi:nodetypes="cc"', 1),
        "two roots": text + text,
        "UTF-7": '<?xml version="1.0" encoding="UTF-7"?>' + text,
        "no such encoding": '<?xml version="1.0" encoding="x"?>' + text,
        "comment": text.replace("<path", "<!-- <path", 1),
    }


def urdf(text: str) -> dict[str, str]:
    """Of a robot."""
    name = "<robot"
    start = text.index(name)

    def inside(content: str) -> str:
        return text.replace("</robot>", content + "</robot>")

    def joint(words: str, kind: str = "fixed") -> str:
        first = re.findall(r'<link name="([^"]*)"', text)[-1]
        return inside(
            f'<link name="more"/><joint name="more_j" type="{kind}"><parent link="{first}"/>'
            f'<child link="more"/>{words}</joint>'
        )

    def shape(geometry: str) -> str:
        return inside(
            f'<link name="body"><visual><geometry>{geometry}</geometry></visual><collision>'
            f"<geometry>{geometry}</geometry></collision></link>" + _joined(text, "body")
        )

    space = '<robot xmlns:xacro="http://www.ros.org/wiki/xacro"'
    xacro = text.replace(name, space, 1)

    def macro(content: str) -> str:
        return xacro.replace("</robot>", content + "</robot>")

    return {
        "an entity": text[:start] + _ENTITY + text[start:].replace("</robot>", "&x;</robot>"),
        "remote": text[:start] + _REMOTE + text[start:],
        "xacro": macro('<xacro:include filename="x.urdf.xacro"/>'),
        "a sum": macro('<xacro:property name="a" value="${1/0}"/><link name="${a}"/>'),
        "code": macro("""<link name="${__import__('os').getcwd()}"/>"""),
        "endless": macro('<xacro:macro name="m"><xacro:m/></xacro:macro><xacro:m/>'),
        "find": macro('<xacro:include filename="$(find nothing)/x"/>'),
        "env": macro('<link name="$(env X)"/>'),
        "package": shape('<mesh filename="package://nothing/x.stl"/>'),
        "model": shape('<mesh filename="model://nothing/x.dae"/>'),
        "missing": shape('<mesh filename="x.stl"/>'),
        "endless mesh": shape('<mesh filename="/dev/zero"/>'),
        "its own mesh": shape('<mesh filename="arm.urdf"/>'),
        "remote mesh": shape('<mesh filename="http://127.0.0.1:9/x.stl"/>'),
        "file mesh": shape('<mesh filename="file:///etc/passwd"/>'),
        "no mesh": shape("<mesh/>"),
        "mesh scale": shape('<mesh filename="x.stl" scale="0 nan 1"/>'),
        "capsule": shape('<capsule radius="1" length="2"/>'),
        "no shape": shape(""),
        "two shapes": shape('<box size="1 1 1"/><sphere radius="1"/>'),
        "box below": shape('<box size="-1 -1 -1"/>'),
        "huge box": shape('<box size="1e30 1e30 1e30"/>'),
        "spheres": shape('<sphere radius="1"/>').replace(
            "<visual>", "<visual/>" * 3000 + "<visual>"
        ),
        "mimic of itself": joint(
            '<mimic joint="more_j"/><axis xyz="1 0 0"/>'
            '<limit effort="1" velocity="1" lower="0" upper="1"/>',
            "revolute",
        ),
        "mimic of none": joint('<mimic joint="nothing"/>', "revolute"),
        "planar": joint('<axis xyz="0 0 1"/>', "planar"),
        "ball": joint("", "spherical"),
        "no kind": joint("", ""),
        "loose": joint("", "floating"),
        "no axis": joint('<axis xyz="0 0 0"/>', "continuous"),
        "no limit": joint('<axis xyz="0 0 1"/>', "revolute"),
        "turned limits": joint(
            '<axis xyz="0 0 1"/><limit lower="1" upper="-1" effort="1" velocity="1"/>', "prismatic"
        ),
        "two roots": inside('<link name="alone"/>'),
        "a link twice": inside(re.search(r"<link [^>]*?(/>|>.*?</link>)", text, re.S)[0]),
        "no link": "<robot name='a'/>",
        "SDF": '<sdf version="1.7"><model name="a"/></sdf>',
        "MJCF": "<mujoco><worldbody/></mujoco>",
        "letters": text.replace('name="', 'name="\u03b1\u202e'),
        "a name empty": re.sub(r'<link name="[^"]*"', '<link name=""', text, count=1),
        "negative mass": re.sub(r'<mass value="[^"]*"', '<mass value="-1"', text),
        "long": inside("<!--" + "x" * 3_000_000 + "-->"),
        "degrees": re.sub(
            r'(lower|upper)="([^"]*)"', lambda m: f'{m[1]}="{57.3 * float(m[2])}"', text
        ),
        "still": re.sub(r'(lower|upper)="[^"]*"', r'\1="0"', text),
        "slow": re.sub(r'velocity="[^"]*"', 'velocity="1e-12"', text),
        "far": re.sub(r'<origin xyz="[^"]*"', '<origin xyz="0 0 1e9"', text),
        "plugins": inside("<gazebo><plugin filename='x.so'/></gazebo><transmission/>"),
        "deep": inside("<a>" * 900 + "</a>" * 900),
        "chain": inside(_chain(text, 400)),
    }


def _joined(text: str, child: str) -> str:
    parent = re.findall(r'<link name="([^"]*)"', text)[0]
    ends = f'<parent link="{parent}"/><child link="{child}"/>'
    return f'<joint name="{child}_j" type="fixed">{ends}</joint>'


def _chain(text: str, count: int) -> str:
    parent = re.findall(r'<link name="([^"]*)"', text)[-1]
    names = [parent, *(f"c{k}" for k in range(count))]
    return "".join(
        f'<link name="{b}"/><joint name="{b}_j" type="revolute"><parent link="{a}"/>'
        f'<child link="{b}"/><axis xyz="0 0 1"/>'
        '<limit lower="-1" upper="1" effort="1" velocity="1"/></joint>'
        for a, b in itertools.pairwise(names)
    )


def usda(text: str) -> dict[str, str]:
    """Of a scene."""

    def world(content: str) -> str:
        return text.replace('def Xform "World"\n{', 'def Xform "World"\n{\n' + content + "\n", 1)

    def layer(content: str) -> str:
        return text.replace("metersPerUnit = 1", "metersPerUnit = 1\n " + content)

    def unit(value: str) -> str:
        return text.replace("metersPerUnit = 1", f"metersPerUnit = {value}")

    mesh = (
        'def Mesh "m" {{ point3f[] points = [(0,0,0),(1,0,0),(0,1,0)]\n'
        "int[] faceVertexCounts = [{}]\nint[] faceVertexIndices = [{}] }}"
    )
    deep = "".join(f'def Xform "d{k}" {{\n' for k in range(600)) + "}" * 600
    return {
        "itself": layer("subLayers = [@stage.usda@]"),
        "a device": layer("subLayers = [@/dev/zero@]"),
        "missing": layer("subLayers = [@nothing.usda@]"),
        "a payload": world('def "p" (payload = @/dev/full@) {}'),
        "its own": world('def "p" (references = </World>) {}'),
        "remote": world('def "p" (references = @http://127.0.0.1:9/x.usd@) {}'),
        "unit 0": unit("0"),
        "unit nan": unit("nan"),
        "unit below": unit("-1"),
        "unit huge": unit("1e300"),
        "up X": text.replace('"Z"', '"X"'),
        "up words": text.replace('"Z"', "7"),
        "deep": world(deep),
        "no such point": world(mesh.format("3", "0, 1, 99")),
        "below": world(mesh.format("3", "0, -1, 2")),
        "count": world(mesh.format("1000000", "0, 1, 2")),
        "no faces": world(mesh.format("", "")),
        "a flat radius": text.replace("radius = 0.1", "radius = 0"),
        "radius nan": text.replace("radius = 0.1", "radius = nan"),
        "radius huge": text.replace("radius = 0.1", "radius = 1e30"),
        "moving": text.replace(
            "double radius = 0.1", "double radius.timeSamples = {0: nan, 1: 1e9}"
        ),
        "instances": world(
            'def PointInstancer "i" { rel prototypes = </World/s>\n'
            "int[] protoIndices = [0, 9]\npoint3f[] positions = [(0,0,0),(nan,0,0)] }"
        ),
        "camera": text.replace('"perspective"\n {', '"perspective"\n {\n  float focalLength = nan'),
        "camera flat": text.replace(
            '"perspective"\n {', '"perspective"\n {\n  float focalLength = 0'
        ),
        "no camera": re.sub(r'def Camera "perspective"\s*{\s*}', "", text),
        "nothing": "#usda 1.0\n",
        "a later format": text.replace("#usda 1.0", "#usda 9.9"),
        "binary said": text.replace("#usda 1.0", "PXR-USDC"),
        "no head": text.replace("#usda 1.0", ""),
        "cut": text[:-9],
        "no matrix": world(
            "matrix4d xformOp:transform = ((nan,0,0,0),(0,0,0,0),(0,0,0,0),(0,0,0,0))\n"
            'uniform token[] xformOpOrder = ["xformOp:transform"]'
        ),
        "hidden": world('token visibility = "invisible"'),
        "curves": world(
            'def BasisCurves "b" { int[] curveVertexCounts = [4, 9]\npoint3f[] points = [(0,0,0)] }'
        ),
        "letters": text.replace('"s"', '"s\u202e"'),
        "a name twice": world('def Sphere "s" {}'),
        "a plugin": layer('customLayerData = { string x = "`id`" }'),
        "times": layer("startTimeCode = 1e300\n endTimeCode = -1e300\n timeCodesPerSecond = 0"),
        "many": world("".join(f'def Cube "k{k}" {{}}\n' for k in range(3000))),
    }


KINDS = {"svg": svg, "urdf": urdf, "usda": usda}
