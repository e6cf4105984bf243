// SPDX-License-Identifier: GPL-3.0-or-later
// Lists the content of GLB files as Babylon.js and three.js read it, and errors that Khronos' validator finds, as JSON.
// node loaders.mjs NODE_MODULES FILE...: NODE_MODULES has gltf-validator, @babylonjs/core, @babylonjs/loaders and three.
import fs from "node:fs";
import { createRequire } from "node:module";
import path from "node:path";
import { pathToFileURL } from "node:url";

const [modules, ...files] = process.argv.slice(2);
const load = (name) => import(pathToFileURL(path.resolve(modules, name)));
globalThis.self = globalThis; // decoders expect a browser

const validator = createRequire(path.resolve(modules, "_.js"))("gltf-validator");
const babylon = await load("@babylonjs/core/index.js");
await load("@babylonjs/loaders/glTF/index.js");
const { GLTFLoader } = await load("three/examples/jsm/loaders/GLTFLoader.js");
const { MeshoptDecoder } = await load("three/examples/jsm/libs/meshopt_decoder.module.js");
await MeshoptDecoder.ready;

// Babylon.js downloads its decoders; these are the same ones, from the packages.
babylon.Logger.LogLevels = 0;
const draco = path.resolve(modules, "three/examples/jsm/libs/draco/gltf");
const wrapper = fs.readFileSync(path.join(draco, "draco_wasm_wrapper.js"), "utf8");
Object.assign(babylon.DracoDecoder.DefaultConfiguration, {
  numWorkers: 0,
  jsModule: new Function("require", "__dirname", "__filename", `${wrapper}; return DracoDecoderModule;`)(
    createRequire(import.meta.url), draco, draco),
  wasmBinary: fs.readFileSync(path.join(draco, "draco_decoder.wasm")).buffer,
});
babylon.MeshoptCompression._Default = {
  async decodeGltfBufferAsync(source, count, stride, mode, filter) {
    const result = new Uint8Array(count * stride);
    MeshoptDecoder.decodeGltfBuffer(result, count, stride, source, mode, filter);
    return result;
  },
};

const readers = {
  async "gltf-validator"(bytes) {
    const { issues } = await validator.validateBytes(bytes);
    return { errors: issues.numErrors };
  },
  async "Babylon.js"(bytes) {
    const scene = new babylon.Scene(new babylon.NullEngine());
    const address = `data:model/gltf-binary;base64,${Buffer.from(bytes).toString("base64")}`;
    const { meshes } = await babylon.ImportMeshAsync(address, scene, { pluginExtension: ".glb" });
    return sum(meshes.filter((mesh) => mesh.getTotalVertices()).map((mesh) => ({
      name: mesh.name, vertices: mesh.getTotalVertices(), triangles: mesh.getTotalIndices() / 3,
      joints: mesh.skeleton?.bones.length ?? 0,
      targets: Array.from({ length: mesh.morphTargetManager?.numTargets ?? 0 }, (_, number) =>
        mesh.morphTargetManager.getTarget(number).name),
    })));
  },
  async "three.js"(bytes) {
    const loader = new GLTFLoader().setMeshoptDecoder(MeshoptDecoder);
    const { scene } = await new Promise((resolve, reject) => loader.parse(bytes.buffer, "", resolve, reject));
    const meshes = [];
    scene.traverse((mesh) => mesh.isMesh && meshes.push({
      name: mesh.name, vertices: mesh.geometry.attributes.position.count, triangles: mesh.geometry.index.count / 3,
      joints: mesh.skeleton?.bones.length ?? 0, targets: Object.keys(mesh.morphTargetDictionary ?? {}),
    }));
    return sum(meshes);
  },
};

function sum(meshes) {
  const total = (key) => meshes.reduce((all, mesh) => all + mesh[key], 0);
  return { names: meshes.map((mesh) => mesh.name), vertices: total("vertices"), triangles: total("triangles"),
    joints: Math.max(0, ...meshes.map((mesh) => mesh.joints)),
    targets: [...new Set(meshes.flatMap((mesh) => mesh.targets))] };
}

const found = [];
for (const file of files) {
  for (const [reader, read] of Object.entries(readers)) {
    const bytes = new Uint8Array(fs.readFileSync(file));
    let content;
    try {
      content = await read(bytes);
    } catch (error) {
      content = { problem: String(error.message ?? error).split("==: ").pop().slice(-120) };
    }
    found.push({ file: path.basename(file), reader, ...content });
  }
}
console.log(JSON.stringify(found));
process.exit(0);
