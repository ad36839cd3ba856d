// SPDX-License-Identifier: Apache-2.0
// Khronos' validator on .glb files: node validate_gltf.js VALIDATOR FILE…; fails on errors and warnings.
const fs = require('fs');
const validator = require(process.argv[2]);
(async () => {
  let bad = 0;
  for (const file of process.argv.slice(3)) {
    const report = await validator.validateBytes(new Uint8Array(fs.readFileSync(file)));
    const {numErrors, numWarnings, messages} = report.issues;
    console.log(`${file}: ${numErrors} errors, ${numWarnings} warnings; ${report.info.totalVertexCount} vertices, ${report.info.totalTriangleCount} triangles`);
    for (const m of messages) console.log(`  ${m.code} ${m.message} ${m.pointer || ''}`);
    bad += numErrors + numWarnings;
  }
  process.exit(bad ? 1 : 0);
})();
