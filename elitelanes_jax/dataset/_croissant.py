"""Croissant 1.1: a description of a dataset that programs read, for search and for loading.

The format is that of https://docs.mlcommons.org/croissant/docs/croissant-spec-1.1.html, with fields
of its vocabulary for responsible AI. The card of the dataset says the same.
"""

from collections.abc import Sequence
from hashlib import file_digest
from pathlib import Path

from elitelanes_jax._util.types import Plain
from elitelanes_jax.dataset._card import LICENCES, TAGS, TITLE, introduce, tasks_of
from elitelanes_jax.dataset._fields import NUMBER, TEXT, WHOLE, Contents, Field
from elitelanes_jax.dataset._layouts import Layout
from elitelanes_jax.dataset._samples import layer_names
from elitelanes_jax.dataset.tables import DatasetRecord

Node = dict[str, Plain]

_SPECIFICATION = "http://mlcommons.org/croissant/"
_KINDS = {WHOLE: "sc:Integer", NUMBER: "sc:Float", TEXT: "sc:Text"}

# The terms of Croissant that are no terms of schema.org.
_TERMS = """
arrayShape citeAs column containedIn equivalentProperty extract field fileProperty fileObject
fileSet format includes isArray isLiveDataset jsonPath key md5 parentField path recordSet references
regex repeated replace samplingRate separator source subField transform
"""

_CONTEXT = {
    "@language": "en",
    "@vocab": "https://schema.org/",
    "cr": _SPECIFICATION,
    "dct": "http://purl.org/dc/terms/",
    "rai": f"{_SPECIFICATION}RAI/",
    "sc": "https://schema.org/",
    **{term: f"cr:{term}" for term in _TERMS.split()},
    "conformsTo": "dct:conformsTo",
    "data": {"@id": "cr:data", "@type": "@json"},
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
    "description": {"@container": "@language"},
    "examples": {"@id": "cr:examples", "@type": "@json"},
    "name": {"@container": "@language"},
}

_LAYERS = {
    "image": "the picture",
    "labels": "the label of each pixel: {classes}",
    "instances": "the number of the object at each pixel, 0 for none",
}

_RESPONSIBLE = {
    "dataCollection": "A program evolves or reads road networks of tiles, draws them with pictures "
    "of tiles and objects, and views them. The settings are in dataset.json.",
    "dataCollectionType": "Software Collection",
    "dataAnnotationProtocol": "Labels, boxes and poses follow from the geometry of the drawing. "
    "Nobody annotated a picture.",
    "dataPreprocessingProtocol": "The light, the colours, blur and noise of pictures vary as the "
    "settings say.",
    "dataBiases": "Roads are those of a Duckietown, with traffic on the right. All pictures show "
    "the tiles and objects of one set.",
    "dataLimitations": "A network that was trained on drawings may fail on photographs.",
    "dataUseCases": "Training and testing of networks that label roads, find objects, or find a "
    "robot's position in its lane, for robots of a miniature city.",
    "personalSensitiveInformation": "The package's own pictures show no person. Pictures of other "
    "tile and object sets may.",
}


def describe_croissant(
    out: Path,
    about: DatasetRecord,
    contents: Contents,
    layout: Layout,
    splits: Sequence[int],
    present: Sequence[str] = (),
    introduction: str = "",
) -> Node:
    """Returns the description of a dataset, for ``croissant.json``.

    Args:
      out: the folder of the dataset.
      about: the record in ``dataset.json``.
      contents: the fields of the samples' metadata.
      layout: the layout of the folder.
      splits: the splits that have pictures.
      present: the names of the metadata's fields; without any, the metadata is left out.
      introduction: a text before the card's.
    """
    licence = about["tile_set"]["licence"]
    if licence.lower() in LICENCES:
        licence = f"https://spdx.org/licenses/{licence}"
    classes = ", ".join(f"{entry['label']} {entry['name']}" for entry in about["classes"])
    writer = _Writer(out, contents, layout, splits, present, classes)
    return {
        "@context": _CONTEXT,
        "@type": "Dataset",
        "name": TITLE,
        "description": " ".join([introduction, *introduce(about)]).strip(),
        "conformsTo": [f"{_SPECIFICATION}1.1", f"{_SPECIFICATION}RAI/1.0"],
        **({"license": licence} if licence else {}),
        "keywords": [*TAGS, *tasks_of(about)],
        "version": about["versions"]["elitelanes_jax"],
        **{f"rai:{name}": text for name, text in _RESPONSIBLE.items()},
        "distribution": writer.distribution(),
        "recordSet": [writer.split_names(), *writer.record_sets()],
    }


class _Writer:
    """Makes the files and the sets of records of a description."""

    def __init__(
        self,
        out: Path,
        contents: Contents,
        layout: Layout,
        splits: Sequence[int],
        present: Sequence[str],
        classes: str,
    ) -> None:
        self._out, self._contents, self._layout = out, contents, layout
        self._splits, self._present, self._classes = splits, present, classes
        self._names = [layout.split_name(split) for split in splits]
        self._layers = layer_names(has_objects=contents.objects)
        self._is_tar = layout.path.endswith(".tar")
        self._is_parquet = layout.path.endswith(".parquet")

    def distribution(self) -> list[Node]:
        """Returns the files."""
        if self._is_parquet:
            patterns = [self._layout.shards_pattern(split) for split in self._splits]
            return [_file_set("shards", "application/x-parquet", patterns)]
        if self._is_tar:
            return self._tar_files()
        sets = []
        for layer in self._layers:
            patterns = [
                self._layout.file(split, 0, layer).replace("000000", "*") for split in self._splits
            ]
            sets.append(_file_set(f"{layer}-files", "image/png", patterns))
        if self._present:
            lists = [self._layout.list_file(split) for split in self._splits]
            sets.append(_file_set("metadata-files", "application/jsonlines", lists))
        return sets

    def _tar_files(self) -> list[Node]:
        """Returns the shards, and the files in the shards of each split."""
        shards: list[Node] = []
        sets: list[Node] = []
        contents = {layer: ("image/png", f"*.{layer}.png") for layer in self._layers}
        contents["metadata"] = "application/json", "*.json"
        for split, name in zip(self._splits, self._names, strict=True):
            within = []
            for file in sorted(self._out.glob(self._layout.shards_pattern(split))):
                path = file.relative_to(self._out).as_posix()
                with file.open("rb") as stream:
                    digest = file_digest(stream, "sha256").hexdigest()
                shard = {"@id": path, "name": f"{name} {file.name}", "contentUrl": path}
                shard |= {"encodingFormat": "application/x-tar", "sha256": digest}
                shards.append({"@type": "cr:FileObject", **shard})
                within.append({"@id": path})
            for layer, (encoding, pattern) in contents.items():
                files_of_layer = _file_set(f"{name}-{layer}-files", encoding, [pattern])
                sets.append(files_of_layer | {"containedIn": within})
        return shards + sets

    def split_names(self) -> Node:
        """Returns the set of the splits' names."""
        kinds = ("TrainingSplit", "ValidationSplit", "TestSplit")
        rows = [
            {"splits/name": name, "splits/url": f"{_SPECIFICATION}{kinds[split]}"}
            for split, name in zip(self._splits, self._names, strict=True)
        ]
        fields = [
            _field("splits/name", "sc:Text", "the name of the split"),
            _field("splits/url", "sc:URL", "its purpose"),
        ]
        return _record_set("splits", "the splits", fields) | {
            "dataType": "cr:Split",
            "key": {"@id": "splits/name"},
            "data": rows,
        }

    def record_sets(self) -> list[Node]:
        """Returns the sets of records: all in one for Parquet, otherwise one for each layer."""
        if self._is_parquet:
            fields = [self._split_field("samples", "shards")]
            fields += [self._layer_field("samples", layer, "shards") for layer in self._layers]
            fields += self._metadata_fields("samples", "shards")
            return [_record_set("samples", "a row for each sample", fields)]
        prefixes = [f"{name}-" for name in self._names] if self._is_tar else [""]
        sets = []
        for prefix in prefixes:
            for layer in self._layers:
                name, files = f"{prefix}{layer}", f"{prefix}{layer}-files"
                fields = [self._split_field(name, files, prefix), self._number_field(name, files)]
                fields.append(self._layer_field(name, layer, files))
                sets.append(_record_set(name, self._words_for(layer), fields))
            if self._present:
                name, files = f"{prefix}metadata", f"{prefix}metadata-files"
                fields = [self._split_field(name, files, prefix)]
                if self._is_tar:
                    # Readers of Croissant do not look into JSON in archives.
                    fields += [self._number_field(name, files), self._json_field(name, files)]
                else:
                    fields += self._metadata_fields(name, files)
                sets.append(_record_set(name, "the metadata of each sample", fields))
        return sets

    def _words_for(self, layer: str) -> str:
        return _LAYERS[layer].format(classes=self._classes)

    def _split_field(self, name: str, files: str, prefix: str = "") -> Node:
        field = _field(f"{name}/split", "sc:Text", "the split of the sample")
        if prefix:
            # Files in an archive do not know its split.
            return field | {"value": prefix.removesuffix("-")}
        # A name of a split alone is matched too, because readers apply a transform twice.
        transform = {"regex": rf"(?:.*/)?({'|'.join(self._names)})(?:[-./].*)?$"}
        source = _source(files, {"fileProperty": "fullpath"}) | {"transform": transform}
        return field | {"source": source, "references": {"field": {"@id": "splits/name"}}}

    def _number_field(self, name: str, files: str) -> Node:
        source = _source(files, {"fileProperty": "filename"}) | {"transform": {"regex": r"(\d+).*"}}
        words = "the index of the sample in the dataset, from 0"
        return _field(f"{name}/number", "sc:Integer", words) | {"source": source}

    def _layer_field(self, name: str, layer: str, files: str) -> Node:
        source = _source(files, {"fileProperty": "content"})
        if self._is_parquet:
            source = _source(files, {"column": layer}) | {"transform": {"jsonPath": "bytes"}}
        field = _field(f"{name}/{layer}", "sc:ImageObject", self._words_for(layer))
        return field | {"source": source}

    def _json_field(self, name: str, files: str) -> Node:
        words = f"the metadata of the sample, JSON with the entries {', '.join(self._present)}"
        source = _source(files, {"fileProperty": "content"})
        return _field(f"{name}/json", "sc:Text", words) | {"source": source}

    def _metadata_fields(self, name: str, files: str) -> list[Node]:
        fields = []
        for group in self._contents.groups():
            words = group.about.replace("`", "").replace("\n", " ")
            for field in group.fields:
                if field.name in self._present:
                    fields.append(self._metadata_field(name, files, field, words))
        return fields

    def _metadata_field(self, name: str, files: str, field: Field, words: str) -> Node:
        place = f"{name}/{field.name}"
        source = _source(files, {"column": field.name})
        if field.kind:
            return _typed(_field(place, _KINDS[field.kind], words), field.axes) | {"source": source}
        parts = []
        for part in field.parts:
            assert part.kind is not None
            node = _field(f"{place}/{part.name}", _KINDS[part.kind], f"{field.name}: {part.name}")
            path = self._layout.renamed.get(part.name, part.name) if field.axes else part.name
            within = source | {"transform": {"jsonPath": path}}
            parts.append(_typed(node, part.axes + field.axes) | {"source": within})
        node = {"@type": "cr:Field", "@id": place, "name": place, "description": words}
        return _typed(node, field.axes) | {"subField": parts}


def _file_set(name: str, encoding: str, includes: Sequence[str]) -> Node:
    return {
        "@type": "cr:FileSet",
        "@id": name,
        "name": name,
        "encodingFormat": encoding,
        "includes": [*includes],
    }


def _record_set(name: str, words: str, fields: Sequence[Node]) -> Node:
    node = {"@type": "cr:RecordSet", "@id": name, "name": name, "description": words}
    return node | {"field": [*fields]}


def _field(place: str, kind: str, words: str) -> Node:
    return {
        "@type": "cr:Field",
        "@id": place,
        "name": place,
        "description": words,
        "dataType": kind,
    }


def _source(files: str, extract: dict[str, str]) -> Node:
    return {"fileSet": {"@id": files}, "extract": extract}


def _typed(node: Node, axes: int) -> Node:
    """Returns a field of arrays with some axes, of any lengths."""
    if not axes:
        return node
    return node | {"isArray": True, "arrayShape": ",".join(["-1"] * axes)}
