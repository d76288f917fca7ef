//! Pictures: PNG, JPEG and WebP to texels and their smaller copies, and texels to PNG.

use std::io::Cursor;
use std::sync::OnceLock;

use crate::artifact::mesh::Wrap;

/// Larger pictures are not read.
const MOST_TEXELS: u64 = 1 << 27;

/// Texels as they are on a screen, red, green, blue, alpha, rows from the top.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Level {
    pub width: u32,
    pub height: u32,
    pub texels: Vec<[u8; 4]>,
}

/// A picture, and copies of half the size each down to one texel.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    pub levels: Vec<Level>,
}

/// Light of a value from 0 to 255 on a screen: the sRGB curve (IEC 61966-2-1).
fn decoded(value: f64) -> f32 {
    let v = value / 255.0;
    (if v <= 0.04045 { v / 12.92 } else { libm::pow((v + 0.055) / 1.055, 2.4) }) as f32
}

/// Light of each value on a screen.
pub fn linear() -> &'static [f32; 256] {
    static TABLE: OnceLock<[f32; 256]> = OnceLock::new();
    TABLE.get_or_init(|| std::array::from_fn(|i| decoded(i as f64)))
}

/// Each value as a part of 255.
fn parts() -> &'static [f32; 256] {
    static TABLE: [f32; 256] = {
        let mut table = [0.0; 256];
        let mut i = 0;
        while i < 256 {
            table[i] = i as f32 / 255.0;
            i += 1;
        }
        table
    };
    &TABLE
}

/// The value on a screen nearest to a light.
pub fn screen(light: f32) -> u8 {
    // Boundaries half way between two values: the table is what a search finds, the same everywhere. Beside them where to
    // look first, for each exponent and five bits more: four boundaries at most lie there.
    static TABLES: OnceLock<([f32; 256], Vec<u8>)> = OnceLock::new();
    let (bounds, first) = TABLES.get_or_init(|| {
        let mut bounds: [f32; 256] = std::array::from_fn(|i| decoded(i as f64 + 0.5));
        bounds[255] = f32::INFINITY;
        let from = |i: u32| bounds.partition_point(|&b| b <= f32::from_bits(i << LOOK)) as u8;
        (bounds, (0..=1.0f32.to_bits() >> LOOK).map(from).collect())
    });
    // Less than nothing, or no number, is nothing.
    let light = if light > 0.0 { light.min(1.0) } else { 0.0 };
    let mut value = first[(light.to_bits() >> LOOK) as usize];
    while bounds[usize::from(value)] <= light {
        value += 1;
    }
    value
}

/// Bits of a light that tell nothing of where to look.
const LOOK: u32 = 18;

impl Picture {
    /// The picture in a file's bytes, or why it cannot be read.
    pub fn decode(bytes: &[u8]) -> Result<Self, String> {
        Level::decode(bytes).map(Self::of)
    }

    /// With its smaller copies: means of light, weighted by alpha.
    pub fn of(level: Level) -> Self {
        let mut levels = vec![level];
        while let Some(last) = levels.last()
            && (last.width > 1 || last.height > 1)
        {
            levels.push(last.half());
        }
        Self { levels }
    }

    /// Light and alpha at a place, u right, v down, in the copy of this number.
    pub fn at(&self, uv: [f32; 2], wrap: [Wrap; 2], nearest: bool, level: usize) -> [f32; 4] {
        let (table, parts) = (linear(), parts());
        let light = |[r, g, b, a]: [u8; 4]| {
            [table[usize::from(r)], table[usize::from(g)], table[usize::from(b)], parts[usize::from(a)]]
        };
        let (four, share) = self.around(uv, wrap, nearest, level, light);
        mixed(four, share)
    }

    /// Alphas of the four texels around a place, and how much of the second column and row there is in the mixture.
    #[inline]
    pub fn alphas(&self, uv: [f32; 2], wrap: [Wrap; 2], nearest: bool, level: usize) -> ([u8; 4], [f32; 2]) {
        self.around(uv, wrap, nearest, level, |t| t[3])
    }

    /// Of the four texels around a place, by rows; where the nearest is asked for it is each of them.
    #[inline(always)]
    fn around<T: Copy>(
        &self,
        uv: [f32; 2],
        wrap: [Wrap; 2],
        nearest: bool,
        level: usize,
        value: impl Fn([u8; 4]) -> T,
    ) -> ([T; 4], [f32; 2]) {
        let level = &self.levels[if nearest { 0 } else { level.min(self.levels.len() - 1) }];
        let size = [level.width, level.height];
        let texel = |x: i64, y: i64| {
            let at = [x, y];
            let [x, y] = [0, 1].map(|k| wrapped(at[k], i64::from(size[k]), wrap[k]));
            value(level.texels[y * level.width as usize + x])
        };
        // Places far out, or none, are somewhere.
        let place = [0, 1].map(|k| {
            let v = f64::from(uv[k]) * f64::from(size[k]);
            if v.abs() < 1e12 { v } else { 0.0 }
        });
        if nearest {
            return ([texel(place[0].floor() as i64, place[1].floor() as i64); 4], [0.0; 2]);
        }
        // `floor` is a call on older processors.
        let corner = place.map(|v| {
            let whole = (v - 0.5) as i64;
            whole - i64::from(whole as f64 > v - 0.5)
        });
        let share = [0, 1].map(|k| (place[k] - 0.5 - corner[k] as f64) as f32);
        let [x, y] = corner;
        let [width, height] = size.map(i64::from);
        // Mostly none of the four lies beyond an end.
        let four = if (0..width - 1).contains(&x) && (0..height - 1).contains(&y) {
            let first = (y * width + x) as usize;
            [first, first + 1, first + width as usize, first + width as usize + 1].map(|i| value(level.texels[i]))
        } else {
            [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(dx, dy)| texel(x + dx, y + dy))
        };
        (four, share)
    }
}

#[inline]
fn mixed<const N: usize>(four: [[f32; N]; 4], [u, v]: [f32; 2]) -> [f32; N] {
    let weights = [(1.0 - u) * (1.0 - v), u * (1.0 - v), (1.0 - u) * v, u * v];
    let mut out = [0.0; N];
    for (weight, t) in weights.into_iter().zip(four) {
        (0..N).for_each(|k| out[k] += weight * t[k]);
    }
    out
}

/// Four alphas in these shares.
#[inline]
pub fn mixed_alpha(four: [u8; 4], share: [f32; 2]) -> f32 {
    let [alpha] = mixed(four.map(|a| [parts()[usize::from(a)]]), share);
    alpha
}

fn wrapped(i: i64, n: i64, wrap: Wrap) -> usize {
    (match wrap {
        Wrap::Clamp => i.clamp(0, n - 1),
        Wrap::Repeat => i.rem_euclid(n),
        Wrap::Mirror => {
            let m = i.rem_euclid(2 * n);
            if m < n { m } else { 2 * n - 1 - m }
        }
    }) as usize
}

impl Level {
    /// The picture in a file's bytes, or why it cannot be read.
    pub fn decode(bytes: &[u8]) -> Result<Self, String> {
        if bytes.starts_with(b"\x89PNG") {
            png(bytes)
        } else if bytes.starts_with(b"\xff\xd8") {
            jpeg(bytes)
        } else {
            webp(bytes)
        }
    }

    fn half(&self) -> Self {
        let (width, height) = (self.width.div_ceil(2), self.height.div_ceil(2));
        let table = linear();
        let mut texels = Vec::with_capacity((width * height) as usize);
        for y in 0..height {
            for x in 0..width {
                let (mut sum, mut plain, mut alpha) = ([0.0f32; 3], [0.0f32; 3], 0.0);
                for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
                    let (x, y) = ((2 * x + dx).min(self.width - 1), (2 * y + dy).min(self.height - 1));
                    let t = self.texels[(y * self.width + x) as usize];
                    let a = f32::from(t[3]) / 255.0;
                    alpha += a;
                    for k in 0..3 {
                        let light = table[usize::from(t[k])];
                        sum[k] += a * light;
                        plain[k] += light;
                    }
                }
                let [r, g, b] = [0, 1, 2].map(|k| screen(if alpha > 0.0 { sum[k] / alpha } else { plain[k] / 4.0 }));
                texels.push([r, g, b, (alpha / 4.0 * 255.0).round() as u8]);
            }
        }
        Self { width, height, texels }
    }

    fn new(width: u32, height: u32, channels: usize, bytes: &[u8]) -> Result<Self, String> {
        let n = width as usize * height as usize;
        if n == 0 || bytes.len() < n * channels {
            return Err("holds no texels".into());
        }
        let texel = |t: &[u8]| match *t {
            [grey] => [grey, grey, grey, 255],
            [grey, a] => [grey, grey, grey, a],
            [r, g, b] => [r, g, b, 255],
            _ => [t[0], t[1], t[2], t[3]],
        };
        Ok(Self { width, height, texels: bytes[..n * channels].chunks_exact(channels).map(texel).collect() })
    }

    /// As PNG.
    pub fn png(&self) -> Vec<u8> {
        let mut out = Vec::new();
        let mut encoder = ::png::Encoder::new(&mut out, self.width, self.height);
        encoder.set_color(::png::ColorType::Rgba);
        encoder.set_depth(::png::BitDepth::Eight);
        let mut writer = encoder.write_header().expect("a header of sane numbers");
        writer.write_image_data(self.texels.as_flattened()).expect("as many texels as the header says");
        writer.finish().expect("into memory");
        out
    }
}

impl Level {
    /// As PNG, slower and smaller: without alpha where all is opaque, rows as they are (pictures of flat colours) or as
    /// differences, whichever is less.
    pub fn small_png(&self) -> Vec<u8> {
        let opaque = self.texels.iter().all(|t| t[3] == 255);
        let (colour, bytes) = match opaque {
            true => (::png::ColorType::Rgb, self.texels.iter().flat_map(|t| [t[0], t[1], t[2]]).collect()),
            false => (::png::ColorType::Rgba, self.texels.as_flattened().to_vec()),
        };
        let one = |filter: ::png::Filter| {
            let mut out = Vec::new();
            let mut encoder = ::png::Encoder::new(&mut out, self.width, self.height);
            encoder.set_color(colour);
            encoder.set_depth(::png::BitDepth::Eight);
            encoder.set_compression(::png::Compression::High);
            encoder.set_filter(filter);
            let mut writer = encoder.write_header().expect("a header of sane numbers");
            writer.write_image_data(&bytes).expect("as many texels as the header says");
            writer.finish().expect("into memory");
            out
        };
        let [plain, adaptive] = [::png::Filter::NoFilter, ::png::Filter::Adaptive].map(one);
        if plain.len() <= adaptive.len() { plain } else { adaptive }
    }

    /// As WebP, without loss.
    pub fn webp(&self) -> Result<Vec<u8>, String> {
        let mut out = Vec::new();
        let encoder = image_webp::WebPEncoder::new(&mut out);
        let all = self.texels.as_flattened();
        let done = encoder.encode(all, self.width, self.height, image_webp::ColorType::Rgba8);
        done.map_err(|e| format!("cannot be WebP: {e}"))?;
        Ok(out)
    }
}

fn fits(width: u64, height: u64) -> Result<(), String> {
    let n = width.saturating_mul(height);
    if n > MOST_TEXELS { Err(format!("has {n} texels, more than the {MOST_TEXELS} that are read")) } else { Ok(()) }
}

fn png(bytes: &[u8]) -> Result<Level, String> {
    let wrong = |e: ::png::DecodingError| format!("is damaged: {e}");
    let mut decoder = ::png::Decoder::new(Cursor::new(bytes));
    decoder.set_transformations(::png::Transformations::normalize_to_color8());
    let mut reader = decoder.read_info().map_err(wrong)?;
    fits(reader.info().width.into(), reader.info().height.into())?;
    let mut all = vec![0; reader.output_buffer_size().ok_or("is too large")?];
    let info = reader.next_frame(&mut all).map_err(wrong)?;
    let channels = info.color_type.samples();
    Level::new(info.width, info.height, channels, &all)
}

fn jpeg(bytes: &[u8]) -> Result<Level, String> {
    use zune_jpeg::zune_core::bytestream::ZCursor;
    use zune_jpeg::zune_core::colorspace::ColorSpace;
    use zune_jpeg::zune_core::options::DecoderOptions;
    let options = DecoderOptions::default()
        .jpeg_set_out_colorspace(ColorSpace::RGB)
        .set_max_width(1 << 16)
        .set_max_height(1 << 16);
    let mut decoder = zune_jpeg::JpegDecoder::new_with_options(ZCursor::new(bytes), options);
    decoder.decode_headers().map_err(|e| format!("is damaged: {e:?}"))?;
    let (width, height) = decoder.dimensions().ok_or("has no size")?;
    fits(width as u64, height as u64)?;
    let all = decoder.decode().map_err(|e| format!("is damaged: {e:?}"))?;
    Level::new(width as u32, height as u32, 3, &all)
}

fn webp(bytes: &[u8]) -> Result<Level, String> {
    let wrong = |e: image_webp::DecodingError| format!("is damaged: {e}");
    let mut decoder = image_webp::WebPDecoder::new(Cursor::new(bytes)).map_err(wrong)?;
    let (width, height) = decoder.dimensions();
    fits(width.into(), height.into())?;
    let mut all = vec![0; decoder.output_buffer_size().ok_or("is too large")?];
    decoder.read_image(&mut all).map_err(wrong)?;
    Level::new(width, height, if decoder.has_alpha() { 4 } else { 3 }, &all)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn light_and_back() {
        assert!((0..=255u8).all(|v| screen(linear()[usize::from(v)]) == v));
        assert_eq!((screen(-1.0), screen(2.0), screen(f32::NAN)), (0, 255, 0));
        assert_eq!((screen(f32::INFINITY), screen(-0.0), screen(f32::MIN_POSITIVE / 2.0)), (255, 0, 0));
        // Each value has its share, in order, and begins half way from the one before.
        let mut before = 0;
        for light in (0..=100_000u32).map(|i| i as f32 / 100_000.0) {
            let value = screen(light);
            assert!(value >= before, "{light}");
            if value > 0 && value < 255 {
                let [low, high] = [-0.5, 0.5].map(|d| decoded(f64::from(value) + d));
                assert!(low <= light && light < high, "{light}: {value}");
            }
            before = value;
        }
        assert_eq!(before, 255);
    }

    #[test]
    fn there_and_back() {
        let texels = (0..6u8).map(|i| [i, 40 * i, 255 - i, 255 - 50 * i]).collect();
        let level = Level { width: 3, height: 2, texels };
        let picture = Picture::decode(&level.png()).unwrap();
        assert_eq!(picture.levels[0], level);
        assert_eq!(Level::decode(&level.small_png()).unwrap(), level);
        let opaque = Level { texels: level.texels.iter().map(|t| [t[0], t[1], t[2], 255]).collect(), ..level.clone() };
        assert_eq!(Level::decode(&opaque.small_png()).unwrap(), opaque);
        assert_eq!(picture.levels.iter().map(|l| (l.width, l.height)).collect::<Vec<_>>(), [(3, 2), (2, 1), (1, 1)]);
        for n in 0..level.png().len() - 12 {
            assert!(Picture::decode(&level.png()[..n]).is_err(), "{n}");
        }
        assert_eq!(Picture::decode(&level.webp().unwrap()).unwrap().levels[0], level);
        assert!(Picture::decode(b"\xff\xd8\xff\xe0 no").is_err());
        assert!(Picture::decode(b"RIFF....WEBP").is_err());
    }

    #[test]
    fn between_texels() {
        let level = Level { width: 2, height: 1, texels: vec![[0, 0, 0, 255], [255, 255, 255, 255]] };
        let picture = Picture::of(level);
        let red = |u, wrap| picture.at([u, 0.5], [wrap; 2], false, 0)[0];
        assert_eq!((red(0.25, Wrap::Clamp), red(0.5, Wrap::Clamp), red(0.75, Wrap::Clamp)), (0.0, 0.5, 1.0));
        assert_eq!((red(0.0, Wrap::Clamp), red(0.0, Wrap::Repeat), red(1.25, Wrap::Mirror)), (0.0, 0.5, 1.0));
        assert_eq!(picture.at([0.0, 0.0], [Wrap::Repeat; 2], false, 9)[0], linear()[usize::from(screen(0.5))]);
    }
}
