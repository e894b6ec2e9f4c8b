// Shader text that reads textures: where a normal lies in a texture, and the four texels around it, whatever the codec.
// The same as luxel.kernels.mapping and luxel.kernels.lookup: reconstruction calculates with whole numbers small enough
// for floats, so that a texel has the same code here as there.

/** Where long arrays lie in layers of a texture: 2048 entries a row, 2048 rows a layer. */
export const PLACE = `
ivec3 entry(int k) { return ivec3(k & 2047, (k >> 11) & 2047, k >> 22); }
`;

/** Codes of four texels out of a record; each text defines `vec4 codes(int record, ivec4 texels)`. */
const CODES = /** @type {Record<string, (codec: Reader) => string>} */ ({
  raw: ({ texels }) => `
uniform usampler2DArray uAtlas; // textures one after the other, a byte a texel
vec4 codes(int record, ivec4 at) {
  at += record * ${texels * texels};
  return vec4(texelFetch(uAtlas, entry(at.x), 0).r, texelFetch(uAtlas, entry(at.y), 0).r,
    texelFetch(uAtlas, entry(at.z), 0).r, texelFetch(uAtlas, entry(at.w), 0).r);
}`,

  vq: ({ texels }) => `
uniform usampler2DArray uRecords; // an index each
uniform usampler2DArray uAtlas;   // codewords one after the other
vec4 codes(int record, ivec4 at) {
  at += int(texelFetch(uRecords, entry(record), 0).r) * ${texels * texels};
  return vec4(texelFetch(uAtlas, entry(at.x), 0).r, texelFetch(uAtlas, entry(at.y), 0).r,
    texelFetch(uAtlas, entry(at.z), 0).r, texelFetch(uAtlas, entry(at.w), 0).r);
}`,

  // Four coefficients in a word, four rows of the basis in a texel.
  linear: ({ texels, words, unit }) => `
uniform usampler2DArray uRecords;
uniform isampler2DArray uVectors;
uniform sampler2DArray uOffsets;
vec4 codes(int record, ivec4 at) {
  vec4 sum = vec4(texelFetch(uOffsets, entry(at.x), 0).r, texelFetch(uOffsets, entry(at.y), 0).r,
    texelFetch(uOffsets, entry(at.z), 0).r, texelFetch(uOffsets, entry(at.w), 0).r);
  for (int k = 0; k < ${words}; k++) {
    uint word = texelFetch(uRecords, entry(record * ${words} + k), 0).r;
    vec4 q = vec4((uvec4(word) >> uvec4(0, 8, 16, 24)) & 255u) - 128.0;
    ivec4 row = at + k * ${texels * texels};
    sum += q * mat4(vec4(texelFetch(uVectors, entry(row.x), 0)), vec4(texelFetch(uVectors, entry(row.y), 0)),
      vec4(texelFetch(uVectors, entry(row.z), 0)), vec4(texelFetch(uVectors, entry(row.w), 0)));
  }
  return clamp(floor(sum * ${float(unit)}), 0.0, 255.0);
}`,

  // A record is the index of a cluster and coefficients of 0 to 8 bits. Those of a cluster come in groups of four.
  clustered: ({ texels, words, unit, lead }) => `
uniform usampler2DArray uRecords;
uniform isampler2DArray uVectors;
uniform sampler2DArray uOffsets;
uniform usampler2DArray uClusters; // first group | groups << 24
uniform usampler2DArray uSteps;    // of a coefficient: where its values begin | bits << 24
uniform sampler2DArray uLevels;    // values of quantised coefficients
uint word, next; // of the record: from bit 'bit' of 'word' on is what has not been read
int from, bit;

float coefficient(int k) {
  uint step = texelFetch(uSteps, entry(k), 0).r, symbol = word >> uint(bit);
  int width = int(step >> 24);
  if (bit > 24) symbol |= next << uint(32 - bit);
  symbol &= (1u << uint(width)) - 1u;
  bit += width;
  if (bit >= 32) {
    bit -= 32;
    word = next;
    next = texelFetch(uRecords, entry(from++), 0).r;
  }
  return texelFetch(uLevels, entry(int(step & 0xffffffu) + int(symbol)), 0).r;
}

vec4 codes(int record, ivec4 at) {
  from = record * ${words} + 2;
  word = texelFetch(uRecords, entry(from - 2), 0).r;
  next = texelFetch(uRecords, entry(from - 1), 0).r; // of the next record, if this one is that short: never used then
  int cluster = ${lead ? "int(word & 255u)" : "0"};
  bit = ${8 * lead};
  uint span = texelFetch(uClusters, entry(cluster), 0).r;
  int group = int(span & 0xffffffu), last = group + int(span >> 24);
  ivec4 row = at + cluster * ${texels * texels};
  vec4 sum = vec4(texelFetch(uOffsets, entry(row.x), 0).r, texelFetch(uOffsets, entry(row.y), 0).r,
    texelFetch(uOffsets, entry(row.z), 0).r, texelFetch(uOffsets, entry(row.w), 0).r);
  for (; group < last; group++) {
    vec4 q;
    q.x = coefficient(4 * group);
    q.y = coefficient(4 * group + 1);
    q.z = coefficient(4 * group + 2);
    q.w = coefficient(4 * group + 3);
    row = at + group * ${texels * texels};
    sum += q * mat4(vec4(texelFetch(uVectors, entry(row.x), 0)), vec4(texelFetch(uVectors, entry(row.y), 0)),
      vec4(texelFetch(uVectors, entry(row.z), 0)), vec4(texelFetch(uVectors, entry(row.w), 0)));
  }
  return clamp(floor(sum * ${float(unit)}), 0.0, 255.0);
}`,
});

/**
 * What the text depends on.
 * @typedef {object} Reader
 * @property {"raw" | "vq" | "linear" | "clustered"} form
 * @property {number} texels rows and columns of a texture
 * @property {string} mapping
 * @property {number} words of 32 bits in a record
 * @property {number} unit of sums, in codes
 * @property {number} lead bytes of the cluster's index
 */

/** @param {number} x a power of two */
const float = (x) => (Number.isInteger(x) ? `${x}.0` : x.toExponential(12));

/** Texels beyond an edge lie inside the square: a column's and a row's number to a texel's. */
const WRAPPED = /** @type {Record<string, (texels: number) => string>} */ ({
  // Octahedral texels continue mirrored along the edge …
  octahedral: (texels) => `
  ivec2 inside = clamp(at, 0, ${texels - 1});
  bvec2 beyond = notEqual(at, inside);
  inside = ivec2(beyond.y ? ${texels - 1} - inside.x : inside.x, beyond.x ? ${texels - 1} - inside.y : inside.y);`,
  // … latitude-longitude on the opposite side of a pole.
  latlong: (texels) => `
  ivec2 inside = ivec2(at.x, clamp(at.y, 0, ${texels - 1}));
  if (at.y != inside.y) inside.x += ${texels / 2};
  if (inside.x < 0) inside.x += ${texels};
  if (inside.x >= ${texels}) inside.x -= ${texels};`,
});

const SQUARE = /** @type {Record<string, string>} */ ({
  octahedral: `
  float r = sqrt(dot(n.xy, n.xy) / (1.0 + a.z));
  vec2 p = r * vec2(1.0 - quarters, quarters);
  if (n.z < 0.0) p = 1.0 - p.yx;
  return 0.5 + 0.5 * vec2(n.x < 0.0 ? -p.x : p.x, n.y < 0.0 ? -p.y : p.y);`,
  latlong: `
  float u = 0.25 * (n.x < 0.0 ? 2.0 - quarters : quarters);
  return vec2(n.y < 0.0 ? 1.0 - u : u, atan(length(n.xy), n.z) / PI);`,
});

/**
 * Defines `float textured(int record, int generation, vec3 n)`: luminance of a texture towards the unit normal n,
 * bilinear (paper 3.4). Needs PI, and takes the luminance of codes from a row of 256 for each generation.
 * @param {Reader} reader
 */
export const lookup = (reader) => `
uniform sampler2D uDecoding;
${CODES[reader.form](reader)}
int inside(ivec2 at) { // column, row
  ${WRAPPED[reader.mapping](reader.texels)}
  return inside.y * ${reader.texels} + inside.x;
}

vec2 square(vec3 n) {
  vec3 a = abs(n);
  float quarters = max(a.x, a.y) > 0.0 ? atan(a.y, a.x) / (0.5 * PI) : 0.0; // of the azimuth, within its quadrant
  ${SQUARE[reader.mapping]}
}

float textured(int record, int generation, vec3 n) {
  vec2 at = square(n) * ${reader.texels}.0 - 0.5;
  vec2 base = floor(at), f = at - base;
  ivec2 p = ivec2(base);
  ivec4 c = ivec4(codes(record, ivec4(inside(p), inside(p + ivec2(1, 0)), inside(p + ivec2(0, 1)), inside(p + 1))));
  return mix(
    mix(texelFetch(uDecoding, ivec2(c.x, generation), 0).r, texelFetch(uDecoding, ivec2(c.y, generation), 0).r, f.x),
    mix(texelFetch(uDecoding, ivec2(c.z, generation), 0).r, texelFetch(uDecoding, ivec2(c.w, generation), 0).r, f.x), f.y);
}
`;
