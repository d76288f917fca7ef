//! What a mesh's surface looks like: base colour and alpha at a place of a triangle.

use crate::artifact::Mesh;
use crate::artifact::mesh::{Alpha, Material, Texture};
use crate::geom::space::{doubled_area, unit};

use super::picture::{Picture, mixed_alpha};

/// Pictures that are unpacked side by side, and texels after which no more are.
const AT_ONCE: usize = 4;
const MOST_TEXELS: u64 = 1 << 28;

/// Pictures unpacked, materials at hand.
pub struct Paint<'a> {
    mesh: &'a Mesh,
    /// None where one cannot be read.
    pictures: Vec<Option<Picture>>,
    /// Material of each triangle.
    materials: Vec<u32>,
    plain: Material,
    /// Why pictures cannot be read.
    pub faults: Vec<String>,
}

impl<'a> Paint<'a> {
    pub fn new(mesh: &'a Mesh) -> Self {
        use rayon::prelude::*;
        let images = &mesh.surface.images;
        let mut read: Vec<Result<Picture, String>> = Vec::with_capacity(images.len());
        let all: Vec<usize> = (0..images.len()).collect();
        let mut texels = 0;
        for some in all.chunks(AT_ONCE) {
            let enough = texels > MOST_TEXELS;
            let decode = |&i: &usize| match enough {
                true => Err(format!("is one too many: those before it have {texels} texels")),
                false => Picture::decode(images.image(i)),
            };
            read.extend(some.par_iter().map(decode).collect::<Vec<_>>());
            let size = |p: &Picture| p.levels[0].texels.len() as u64;
            texels += read[some[0]..].iter().flatten().map(size).sum::<u64>();
        }
        let faults = read.iter().enumerate().filter_map(|(i, r)| Some(format!("image {i} {}", r.as_ref().err()?)));
        let faults = faults.collect();
        let mut materials = vec![u32::MAX; mesh.triangles.len()];
        for p in &mesh.primitives {
            let first = p.first_triangle as usize;
            materials[first..first + p.triangles as usize].fill(p.material.unwrap_or(u32::MAX));
        }
        // Nothing says that the backs of bare meshes are not seen.
        let plain = Material { double_sided: true, ..Material::default() };
        Self { mesh, pictures: read.into_iter().map(Result::ok).collect(), materials, plain, faults }
    }

    pub fn material(&self, triangle: usize) -> &Material {
        self.mesh.surface.materials.get(self.materials[triangle] as usize).unwrap_or(&self.plain)
    }

    /// Which copy of its picture a triangle needs that covers this many pixels.
    pub fn level(&self, triangle: usize, pixels: f64) -> usize {
        let Some(texture) = self.material(triangle).texture else { return 0 };
        let Some(Some(picture)) = self.pictures.get(texture.image as usize) else { return 0 };
        let Some([a, b, c]) = self.places(triangle) else { return 0 };
        let size = [picture.levels[0].width, picture.levels[0].height].map(f64::from);
        let side = |p: [f32; 2], k: usize| f64::from(p[k]) - f64::from(a[k]);
        let doubled = (side(b, 0) * side(c, 1) - side(b, 1) * side(c, 0)).abs();
        let ratio = doubled / 2.0 * size[0] * size[1] / pixels.max(1e-9);
        // Four texels a pixel are one copy on.
        if (1.0..1e18).contains(&ratio) { (ratio as u64).ilog2() as usize / 2 } else { 0 }
    }

    fn places(&self, triangle: usize) -> Option<[[f32; 2]; 3]> {
        let uvs = &self.mesh.surface.uvs;
        if uvs.is_empty() { None } else { Some(self.mesh.triangles[triangle].map(|v| uvs[v as usize])) }
    }

    /// What decides where a triangle is drawn; none where all of it is.
    pub fn mask(&self, triangle: usize, level: usize) -> Option<Mask<'_>> {
        let material = self.material(triangle);
        let cutoff = cutoff(material)?;
        let colours = self.colours(triangle);
        // Farther from the cutoff than rounding can tell, a mixture of shown texels is shown.
        let least = 255.0 * cutoff / material.base_colour[3];
        let sure =
            if colours.is_none() && least > 0.0 { [0.999 * least - 0.01, 1.001 * least + 0.01] } else { [-1.0, 256.0] };
        Some(Mask { material, colours, texture: self.texture(triangle), level, sure })
    }

    /// Light and alpha where the corners have these weights; none where nothing is drawn. What is drawn is whole: alpha
    /// decides, at one half where it would be mixed.
    pub fn at(&self, triangle: usize, weights: [f64; 3], level: usize) -> Option<[f32; 3]> {
        let material = self.material(triangle);
        let mut out = material.base_colour;
        let w = weights.map(|w| w as f32);
        if let Some(colours) = self.colours(triangle) {
            for k in 0..4 {
                out[k] *= (0..3).map(|c| w[c] * colours[c][k]).sum::<f32>();
            }
        }
        if let Some((picture, texture, places)) = self.texture(triangle) {
            let texel = picture.at(place(places, w), texture.wrap, texture.nearest, level);
            (0..4).for_each(|k| out[k] *= texel[k]);
        }
        is_drawn(material, out[3]).then_some([out[0], out[1], out[2]])
    }

    fn colours(&self, triangle: usize) -> Option<[[f32; 4]; 3]> {
        let colours = &self.mesh.surface.colours;
        if colours.is_empty() { None } else { Some(self.mesh.triangles[triangle].map(|v| colours[v as usize])) }
    }

    /// A triangle's picture, and its corners' places in it.
    fn texture(&self, triangle: usize) -> Option<(&Picture, &Texture, [[f32; 2]; 3])> {
        let texture = self.material(triangle).texture.as_ref()?;
        let picture = self.pictures.get(texture.image as usize)?.as_ref()?;
        Some((picture, texture, self.places(triangle)?))
    }

    /// The unit normal of a triangle, as its corners turn; 0, 0, 0 where it has no area.
    pub fn face_normal(&self, triangle: usize) -> [f64; 3] {
        unit(doubled_area(self.mesh.corners(triangle)))
    }

    /// The smooth normal at a place; the face's where vertices have none.
    pub fn normal(&self, triangle: usize, weights: [f64; 3]) -> [f64; 3] {
        let normals = &self.mesh.surface.normals;
        let corners = self.mesh.triangles[triangle].map(|v| v as usize);
        if normals.is_empty() || corners.iter().any(|&c| normals[c] == [0.0; 3]) {
            return self.face_normal(triangle);
        }
        let sum = [0, 1, 2].map(|k| (0..3).map(|c| weights[c] * f64::from(normals[corners[c]][k])).sum());
        let smooth = unit(sum);
        if smooth == [0.0; 3] { self.face_normal(triangle) } else { smooth }
    }
}

/// Alpha over a triangle.
pub struct Mask<'a> {
    material: &'a Material,
    colours: Option<[[f32; 4]; 3]>,
    texture: Option<(&'a Picture, &'a Texture, [[f32; 2]; 3])>,
    level: usize,
    /// Texels of less alpha, and of more, that alone decide.
    sure: [f32; 2],
}

impl Mask<'_> {
    /// Whether anything is drawn where the corners have these weights: what [`Paint::at`] says.
    #[inline]
    pub fn shows(&self, weights: [f64; 3]) -> bool {
        let w = weights.map(|w| w as f32);
        let mut alpha = self.material.base_colour[3];
        if let Some(colours) = self.colours {
            alpha *= (0..3).map(|c| w[c] * colours[c][3]).sum::<f32>();
        }
        if let Some((picture, texture, places)) = self.texture {
            let (four, share) = picture.alphas(place(places, w), texture.wrap, texture.nearest, self.level);
            if four.iter().all(|&a| f32::from(a) > self.sure[1]) {
                return true;
            }
            if four.iter().all(|&a| f32::from(a) < self.sure[0]) {
                return false;
            }
            alpha *= mixed_alpha(four, share);
        }
        is_drawn(self.material, alpha)
    }
}

fn place(places: [[f32; 2]; 3], w: [f32; 3]) -> [f32; 2] {
    [0, 1].map(|k| (0..3).map(|c| w[c] * places[c][k]).sum::<f32>())
}

/// The least alpha that is drawn; none where all is.
fn cutoff(material: &Material) -> Option<f32> {
    match material.alpha {
        Alpha::Opaque => None,
        Alpha::Mask(cutoff) => Some(cutoff),
        Alpha::Blend => Some(0.5),
    }
}

fn is_drawn(material: &Material, alpha: f32) -> bool {
    cutoff(material).is_none_or(|cutoff| alpha >= cutoff)
}
