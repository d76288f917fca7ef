//! Bytes to artifacts and back, in the formats' own words.
