"""Names in docstrings, types and pages lead to their entries, however a text calls them."""

import re
from typing import Any

from docutils import nodes
from sphinx import addnodes
from sphinx.domains.python import PythonDomain

import dipoletop

NAME = re.compile(r"(?:dt\.|dipoletop\.)?([A-Za-z]\w*(?:\.\w+)*)(?:\(.*\))?", re.DOTALL)


def candidates(target: str) -> list[str]:
    """The full names that a short one may stand for."""
    target = target.removeprefix("dt.")
    if target.startswith("dipoletop."):  # where it is made; the entry may be at the top level
        last = target.rpartition(".")[2]
        return [f"dipoletop.{last}"] if last in dipoletop.__all__ else []
    return [f"dipoletop.{target}"]


def reference(app: Any, page: str, name: str, text: nodes.Node) -> nodes.reference | None:
    """A reference from a page to the entry of a full name, or None."""
    domain: PythonDomain = app.env.get_domain("py")
    if name not in domain.objects:
        return None
    found = domain.objects[name]
    uri = app.builder.get_relative_uri(page, found.docname)
    anchor = "" if found.objtype == "module" else f"#{found.node_id}"
    return nodes.reference("", "", text, internal=True, refuri=uri + anchor)


def resolve(app: Any, env: Any, node: Any, contnode: Any) -> nodes.reference | None:
    """What Sphinx does not find under the name that is written."""
    if node.get("refdomain") != "py":
        return None
    found = (reference(app, node["refdoc"], n, contnode) for n in candidates(node["reftarget"]))
    return next((node for node in found if node is not None), None)


def link_code(app: Any, doctree: nodes.document, page: str) -> None:
    """Names that a page writes as code lead to their entries."""
    for code in list(doctree.findall(nodes.literal)):
        name = NAME.fullmatch(code.astext())
        if name and not isinstance(code.parent, nodes.reference | nodes.title):
            full = f"dipoletop.{name[1]}"
            found = reference(app, page, full, code.deepcopy())
            if found is not None:
                code.replace_self(found)


def add_anchors(app: Any, doctree: nodes.document) -> None:
    """An entry at the top level can be reached by the place where it is made, too.

    The pages with sources link to it by that name.
    """
    for entry in doctree.findall(addnodes.desc_signature):
        name = entry.get("fullname", "")
        if entry.get("module") == "dipoletop" and name:
            home = getattr(getattr(dipoletop, name.split(".")[0]), "__module__", "dipoletop")
            if home != "dipoletop" and f"{home}.{name}" not in entry["ids"]:
                entry["ids"].append(f"{home}.{name}")


def setup(app: Any) -> dict[str, bool]:
    """Connect to the search for missing references, and to finished pages."""
    app.connect("missing-reference", resolve)
    app.connect("doctree-read", add_anchors)
    app.connect("doctree-resolved", link_code)
    return {"parallel_read_safe": True}
