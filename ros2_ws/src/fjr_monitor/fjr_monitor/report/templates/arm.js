// SPDX-License-Identifier: Apache-2.0
// Draws the scene of a URDF (scene.py) with three.js. A link of the URDF is a group of the scene graph below
// the group of its joint, which turns about, or slides along, the joint's axis.
"use strict";
const Arm = (() => {
  const [SEGMENTS, OPACITY, MARGIN] = [32, 0.42, 1.15];
  const BEHIND = 1; // layer of ghosts and floor, which the arm itself covers
  const [LINK, HUB] = ["#b4bac4", "#59616e"]; // of shapes without a colour
  const POSES = 40; // at which the size of the picture is measured

  const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
  const vector = (numbers) => new THREE.Vector3(...numbers);

  function bytes(text) {
    return Uint8Array.from(atob(text), (character) => character.charCodeAt(0)).buffer;
  }

  // Return the geometry of a mesh (scene.py).
  function meshGeometry({ low, step, vertices, triangles, wide }) {
    const steps = new Uint16Array(bytes(vertices));
    const geometry = new THREE.BufferGeometry();
    const positions = Float32Array.from(steps, (value, i) => low[i % 3] + value * step[i % 3]);
    geometry.setAttribute("position", new THREE.BufferAttribute(positions, 3));
    const corners = wide ? new Uint32Array(bytes(triangles)) : new Uint16Array(bytes(triangles));
    geometry.setIndex(new THREE.BufferAttribute(corners, 1));
    const flat = geometry.toNonIndexed(); // one normal a triangle, which suits reduced meshes
    flat.computeVertexNormals();
    return flat;
  }

  // Turn an object whose length is along y to the direction `to`.
  function along(object, to) {
    object.quaternion.setFromUnitVectors(new THREE.Vector3(0, 1, 0), to.clone().normalize());
    return object;
  }

  function capsule([radius], to, material) {
    const group = new THREE.Group();
    const rod = new THREE.CylinderGeometry(radius, radius, to.length(), SEGMENTS, 1, true);
    group.add(along(new THREE.Mesh(rod, material), to));
    group.children[0].position.copy(to).multiplyScalar(0.5);
    for (const end of [new THREE.Vector3(), to]) {
      const ball = new THREE.Mesh(new THREE.SphereGeometry(radius, SEGMENTS, SEGMENTS / 2), material);
      ball.position.copy(end);
      group.add(ball);
    }
    return group;
  }

  function cylinder(radius, length, material) {
    return new THREE.Mesh(new THREE.CylinderGeometry(radius, radius, length, SEGMENTS), material);
  }

  // Return the object of a shape in the frame of its link.
  function shapeObject(shape, meshes, material) {
    const { kind, size } = shape;
    if (kind === "capsule") return capsule(size, vector(shape.to), material);
    if (kind === "hub") return along(cylinder(size[0], vector(shape.to).length(), material), vector(shape.to));
    const group = placed(shape);
    if (kind === "mesh") group.add(new THREE.Mesh(meshes[shape.mesh], material));
    if (kind === "box") group.add(new THREE.Mesh(new THREE.BoxGeometry(...size), material));
    if (kind === "sphere") group.add(new THREE.Mesh(new THREE.SphereGeometry(size[0], SEGMENTS, SEGMENTS / 2), material));
    if (kind === "cylinder") group.add(cylinder(...size, material).rotateX(Math.PI / 2)); // along z in a URDF
    return group;
  }

  // Return a group at the origin (xyz, rpy) of a URDF element.
  function placed({ xyz, rpy }) {
    const group = new THREE.Group();
    group.position.set(...xyz);
    group.rotation.set(...rpy, "ZYX"); // R = Rz(yaw) Ry(pitch) Rx(roll)
    return group;
  }

  // One arm: the object `group`, posed by the positions of its joints.
  class Chain {
    constructor(scene, meshes, material) {
      this.joints = scene.joints;
      this.frames = {};
      const links = {};
      for (const [name, shapes] of Object.entries(scene.links)) {
        links[name] = new THREE.Group();
        for (const shape of shapes) links[name].add(shapeObject(shape, meshes, material(shape)));
      }
      for (const joint of scene.joints) {
        const frame = new THREE.Group();
        links[joint.parent].add(placed(joint).add(frame));
        this.frames[joint.name] = frame.add(links[joint.child]);
      }
      this.group = links[scene.root];
      this.pose({});
    }

    // Pose the arm; joints that `positions` lacks are where they are locked, or follow the joint that they mimic.
    pose(positions) {
      const of = (joint) => {
        if (positions[joint.name] != null) return positions[joint.name];
        if (!joint.mimics) return joint.position;
        const [name, factor, offset] = joint.mimics;
        return factor * (positions[name] ?? 0) + offset;
      };
      for (const joint of this.joints) {
        const axis = vector(joint.axis).normalize();
        if (joint.kind === "prismatic") this.frames[joint.name].position.copy(axis.multiplyScalar(of(joint)));
        else if (joint.kind !== "fixed") this.frames[joint.name].quaternion.setFromAxisAngle(axis, of(joint));
      }
    }
  }

  function solid(shape) {
    const colour = shape.colour ?? (shape.kind === "hub" ? HUB : LINK);
    return new THREE.MeshPhongMaterial({ color: colour, shininess: 20, specular: "#222222", side: THREE.DoubleSide });
  }

  function ghost(colour) {
    const material = new THREE.MeshLambertMaterial({ transparent: true, opacity: OPACITY, depthWrite: false });
    material.userData.colour = colour;
    return material;
  }

  // Return the direction from the arm to the camera: along the axes if all joints turn about parallel ones.
  function direction(chain, moving) {
    chain.group.updateMatrixWorld(true);
    const turning = chain.joints.filter((joint) => moving.includes(joint.name) && joint.kind !== "prismatic");
    const axes = turning.map((joint) => vector(joint.axis).transformDirection(chain.frames[joint.name].matrixWorld));
    const first = axes[0];
    if (first && axes.every((axis) => Math.abs(axis.dot(first)) > 0.999)) {
      const facing = first.clone().multiplyScalar(first.x - first.y + first.z < 0 ? -1 : 1);
      return facing.add(new THREE.Vector3(0.25, -0.1, 0.22)).normalize();
    }
    return new THREE.Vector3(0.75, -1, 0.55).normalize();
  }

  class View {
    constructor(place, context, canvas, { scene, joints, ghosts }) {
      this.place = place;
      this.renderer = new THREE.WebGLRenderer({ canvas, context, antialias: true, alpha: true });
      this.renderer.autoClear = false;
      this.world = new THREE.Scene();
      this.camera = new THREE.PerspectiveCamera(30, 1, 0.01, 100);
      this.camera.up.set(0, 0, 1);
      const lamp = new THREE.DirectionalLight("#ffffff", 0.62);
      lamp.position.set(-0.6, 0.9, 0.5);
      const sky = new THREE.HemisphereLight("#ffffff", "#8d8f94", 0.55);
      for (const light of [lamp, sky]) light.layers.enableAll();
      this.world.add(sky, this.camera.add(lamp));
      const meshes = scene.meshes.map(meshGeometry);
      this.chains = { link: new Chain(scene, meshes, solid) };
      this.materials = Object.entries(ghosts).map(([name, colour]) => {
        const material = ghost(colour);
        this.chains[name] = new Chain(scene, meshes, () => material);
        this.chains[name].group.traverse((object) => object.layers.set(BEHIND));
        return material;
      });
      for (const chain of Object.values(this.chains)) this.world.add(chain.group);
      this.away = direction(this.chains.link, joints);
      this.control(canvas);
      this.colour();
      new ResizeObserver(() => this.resize()).observe(place);
      matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.colour());
    }

    // Drag turns the arm; the wheel scrolls the page until the picture has the focus.
    control(canvas) {
      this.controls = new THREE.OrbitControls(this.camera, canvas);
      this.controls.enableZoom = false;
      canvas.tabIndex = 0;
      canvas.setAttribute("role", "img");
      canvas.setAttribute("aria-label", "the arm in 3D");
      canvas.style.touchAction = "pan-y pinch-zoom";
      canvas.addEventListener("pointerdown", () => canvas.focus({ preventScroll: true }));
      canvas.addEventListener("focus", () => (this.controls.enableZoom = true));
      canvas.addEventListener("blur", () => (this.controls.enableZoom = false));
      canvas.addEventListener("dblclick", () => this.look());
      this.controls.addEventListener("change", () => this.draw());
    }

    colour() {
      for (const material of this.materials) material.color.set(css(material.userData.colour));
      if (this.floor) this.layFloor();
      this.draw();
    }

    // Measure the arm in the given poses, and show all of them.
    fit(poses) {
      const every = Math.ceil(poses.length / POSES);
      this.corners = poses.filter((_, i) => i % every === 0).flatMap((pose) => this.cornersOf(pose));
      if (!this.corners.length) this.corners = [vector([-1, -1, -1]), vector([1, 1, 1])];
      this.box = new THREE.Box3().setFromPoints(this.corners);
      this.ball = this.box.getBoundingSphere(new THREE.Sphere());
      this.layFloor();
      this.look();
    }

    // Return the corners of the boxes around all shapes in a pose.
    cornersOf(pose) {
      const found = [];
      this.chains.link.pose(pose);
      this.chains.link.group.updateMatrixWorld(true);
      this.chains.link.group.traverse((object) => {
        if (!object.isMesh) return;
        object.geometry.computeBoundingBox();
        const { min, max } = object.geometry.boundingBox;
        for (const x of [min.x, max.x])
          for (const y of [min.y, max.y])
            for (const z of [min.z, max.z]) found.push(vector([x, y, z]).applyMatrix4(object.matrixWorld));
      });
      return found;
    }

    // Return the least distance of the camera from the centre at which all corners are in the picture.
    distance() {
      const across = new THREE.Vector3().crossVectors(this.camera.up, this.away).normalize();
      const upward = new THREE.Vector3().crossVectors(this.away, across);
      const tangent = Math.tan((Math.PI / 360) * this.camera.fov);
      const needed = this.corners.map((corner) => {
        const from = corner.clone().sub(this.ball.center);
        const width = Math.abs(from.dot(across)) / (tangent * this.camera.aspect);
        return from.dot(this.away) + MARGIN * Math.max(width, Math.abs(from.dot(upward)) / tangent);
      });
      return Math.max(...needed, 1.01 * this.ball.radius);
    }

    layFloor() {
      if (this.floor) this.world.remove(this.floor);
      const cell = 10 ** Math.floor(Math.log10(this.ball.radius));
      const count = 2 * Math.ceil((1.6 * this.ball.radius) / cell);
      this.floor = new THREE.GridHelper(count * cell, count, css("grey"), css("grid")).rotateX(Math.PI / 2);
      this.floor.position.set(0, 0, this.box.min.z);
      this.floor.layers.set(BEHIND);
      this.world.add(this.floor);
    }

    look() {
      const distance = this.distance();
      this.camera.near = distance / 100;
      this.camera.far = distance * 20;
      this.camera.position.copy(this.away).multiplyScalar(distance).add(this.ball.center);
      this.controls.target.copy(this.ball.center);
      this.resize();
      this.controls.update();
    }

    resize() {
      const [width, height] = [this.place.clientWidth, this.place.clientHeight];
      if (!width || !height) return;
      this.renderer.setPixelRatio(devicePixelRatio);
      this.renderer.setSize(width, height, false);
      this.camera.aspect = width / height;
      this.camera.updateProjectionMatrix();
      this.draw();
    }

    // Pose the arm or a ghost; null hides it.
    pose(name, positions) {
      this.chains[name].group.visible = positions != null;
      if (positions) this.chains[name].pose(positions);
    }

    draw() {
      if (!this.ball) return;
      this.renderer.clear();
      for (const layer of [BEHIND, 0]) {
        this.renderer.clearDepth();
        this.camera.layers.set(layer);
        this.renderer.render(this.world, this.camera);
      }
    }
  }

  // Return a View that fills `place`, or null after a sentence there if the browser has no WebGL.
  function create(place, parts) {
    const canvas = document.createElement("canvas");
    const look = { antialias: true, alpha: true, preserveDrawingBuffer: true };
    const context = canvas.getContext("webgl2", look) ?? canvas.getContext("webgl", look);
    if (!context) {
      place.textContent = "This browser has no WebGL, which draws the arm; the plots below need none.";
      place.classList.add("unavailable");
      return null;
    }
    place.append(canvas);
    return new View(place, context, canvas, parts);
  }

  return { create, Chain };
})();
