//! Buffer views packed by EXT_meshopt_compression, or by its successor KHR_meshopt_compression.
//!
//! `meshoptimizer-rs` unpacks the streams. Here what a file says of one must agree with itself, and the stream must be able
//! to hold it, before any room is made. Source: the texts of both extensions, with their appendices A and B.

use meshoptimizer_rs::{Error, Workspace, codec};
use serde::Deserialize;
use serde_json::Value;

const EXT: &str = "EXT_meshopt_compression";
const KHR: &str = "KHR_meshopt_compression";

/// All views of a file together are not unpacked to more bytes than that: a kilobyte can hold a megabyte of zeros.
pub const MOST_UNPACKED: u64 = 1 << 30;

/// What a buffer view says of the stream that it is packed in.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub struct Stream {
    pub buffer: usize,
    #[serde(default)]
    pub byte_offset: u64,
    pub byte_length: u64,
    byte_stride: u64,
    count: u64,
    mode: String,
    #[serde(default = "no_filter")]
    filter: String,
}

fn no_filter() -> String {
    "NONE".into()
}

/// The extension among a buffer view's that packs it, and what it says.
pub fn packed(extensions: &Value) -> Option<(&'static str, &Value)> {
    [EXT, KHR].into_iter().find_map(|name| Some((name, extensions.get(name)?)))
}

/// Whether a file that requires this extension can be read for all that.
pub fn is_known(name: &str) -> bool {
    name == EXT || name == KHR
}

impl Stream {
    /// What the extension of this name says, which must fit a view of so many bytes, so many an element.
    pub fn new(name: &str, said: &Value, length: u64, stride: Option<u64>) -> Result<Self, String> {
        let s = Self::deserialize(said).map_err(|e| e.to_string())?;
        let wide = s.byte_stride;
        let (fits, strides) = match (&*s.mode, &*s.filter) {
            ("ATTRIBUTES", "NONE" | "EXPONENTIAL") => {
                (wide % 4 == 0 && (4..=256).contains(&wide), "a multiple of 4 up to 256")
            }
            ("ATTRIBUTES", "OCTAHEDRAL" | "COLOR") => (wide == 4 || wide == 8, "4 or 8"),
            ("ATTRIBUTES", "QUATERNION") => (wide == 8, "8"),
            ("TRIANGLES" | "INDICES", "NONE") => (wide == 2 || wide == 4, "2 or 4"),
            ("ATTRIBUTES" | "TRIANGLES" | "INDICES", filter) => {
                return Err(format!("`{}` is no filter of {}", filter.escape_debug(), s.mode));
            }
            (mode, _) => {
                let mode = mode.escape_debug();
                return Err(format!("`{mode}` is no mode: ATTRIBUTES, TRIANGLES and INDICES are"));
            }
        };
        if !fits {
            return Err(format!("a stride of {wide} bytes, but that of {} ({}) is {strides}", s.mode, s.filter));
        }
        // Its successor has not this rule.
        if let Some(stride) = stride.filter(|&of| name == EXT && of != wide) {
            return Err(format!("a stride of {wide} bytes, but {stride} when unpacked"));
        }
        if s.mode == "TRIANGLES" && s.count % 3 != 0 {
            return Err(format!("{} indices are no triangles", s.count));
        }
        // Triangles and indices take a byte each. Of attributes a block of 1024 bytes, all zero, may take one.
        let (count, bytes) = (u128::from(s.count), u128::from(s.byte_length));
        let most = match &*s.mode {
            "ATTRIBUTES" => 1024 * bytes / u128::from(wide),
            "TRIANGLES" => 3 * bytes,
            _ => bytes,
        };
        if count > most {
            return Err(format!("{bytes} bytes cannot hold {count} elements of {wide} bytes"));
        }
        if count * u128::from(wide) != u128::from(length) {
            return Err(format!("{count} elements of {wide} bytes are not the {length} bytes of the view"));
        }
        Ok(s)
    }

    /// The view's bytes.
    pub fn unpack(&self, bytes: &[u8]) -> Result<Vec<u8>, String> {
        let (count, stride) = (self.count as usize, self.byte_stride as usize);
        let room = &mut Workspace::default();
        let mut out = match &*self.mode {
            "ATTRIBUTES" => codec::decode_vertex_buffer(count, stride, bytes, room),
            "TRIANGLES" => codec::decode_index_buffer(count, stride, bytes, room),
            _ => codec::decode_index_sequence(count, stride, bytes, room),
        }
        .map_err(|e| match e {
            Error::InvalidStream => "its packed bytes end early or are damaged".to_string(),
            other => other.to_string(),
        })?;
        match &*self.filter {
            "OCTAHEDRAL" => codec::decode_filter_oct(&mut out, count, stride, room),
            "QUATERNION" => codec::decode_filter_quat(&mut out, count, stride, room),
            "EXPONENTIAL" => codec::decode_filter_exp(&mut out, count, stride, room).map(|()| one_nan(&mut out)),
            "COLOR" => codec::decode_filter_color(&mut out, count, stride, room),
            _ => Ok(()),
        }
        .map_err(|e| match e {
            Error::NumericalFailure => format!("values that {} cannot have made", self.filter),
            other => other.to_string(),
        })?;
        Ok(out)
    }
}

/// An exponent out of range may give infinity times zero, whose bits differ between processors.
fn one_nan(floats: &mut [u8]) {
    for f in floats.as_chunks_mut::<4>().0 {
        if f32::from_le_bytes(*f).is_nan() {
            *f = 0x7fc0_0000u32.to_le_bytes();
        }
    }
}
